"""State that a view shows besides the scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

ARM_RGB, OBJECT_RGB = ((32, 108, 214), (150, 62, 190)), (20, 150, 90)
"""Colours of the left and right arm, and of the carried object."""


@dataclass(frozen=True)
class Arrow:
    """A force.

    Attributes:
        start: (3,) point of application, world [m].
        force: (3,) world axes [N].
        rgb: 0 to 255.
    """

    start: Array
    force: Array
    rgb: tuple[int, int, int]


@dataclass(frozen=True)
class PathLine:
    """A polyline, such as a TCP path.

    Attributes:
        name: Unique in its preview.
        points: (N, 3) world [m], N >= 2.
        rgb: 0 to 255.
    """

    name: str
    points: Array
    rgb: tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Preview:
    """A plan. Views redraw it only when the object changes, so reuse it while it holds.

    Attributes:
        paths: Lines.
        ghosts: States (nq,) drawn half transparent, e.g. the plan's end.
    """

    paths: tuple[PathLine, ...] = ()
    ghosts: tuple[Array, ...] = ()


NO_PREVIEW = Preview()


@dataclass(frozen=True)
class Overlay:
    """State at one instant. Empty text and None are not shown.

    Attributes:
        time_s: Simulated time [s].
        title: E.g. "carry, trial 3 of 100".
        mode: Source that may drive ("hold" if none), or method name.
        source: Source whose commands reach the motors.
        state: Arbiter state, method phase, or both.
        status: One line.
        pinch_n: Pinch force per hand (left, right) [N].
        internal_n: Squeeze along the object [N].
        arrows: Forces.
        preview: The plan.
    """

    time_s: float = 0.0
    title: str = ""
    mode: str = ""
    source: str = ""
    state: str = ""
    status: str = ""
    pinch_n: tuple[float, float] | None = None
    internal_n: float | None = None
    arrows: tuple[Arrow, ...] = ()
    preview: Preview = NO_PREVIEW


@dataclass(frozen=True)
class Slider:
    """A value that a viewer may set.

    Attributes:
        group: Folder, e.g. "left arm".
        label: E.g. "joint 1 [rad]".
        lower: Minimum.
        upper: Maximum.
        value: Initial value.
    """

    group: str
    label: str
    lower: float
    upper: float
    value: float
