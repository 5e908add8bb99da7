"""What a view shows besides the scene: who drives the arms, how hard they squeeze, where they will go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

ARM_RGB, OBJECT_RGB = ((32, 108, 214), (150, 62, 190)), (20, 150, 90)
"""Colours of the left and the right arm, and of the carried object."""


@dataclass(frozen=True)
class Arrow:
    """A force to draw.

    Attributes:
        start: (3,) where it acts, world [m].
        force: (3,) world axes [N].
        rgb: 0 to 255.
    """

    start: Array
    force: Array
    rgb: tuple[int, int, int]


@dataclass(frozen=True)
class PathLine:
    """A line through the world, such as the way of a tool centre point.

    Attributes:
        name: Unique in its preview, e.g. "left".
        points: (N, 3) world [m], N >= 2.
        rgb: 0 to 255.
    """

    name: str
    points: Array
    rgb: tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Preview:
    """What is planned. A view sends it anew only when it gets another object, so keep one as long as it holds.

    Attributes:
        paths: Lines to draw.
        ghosts: Whole states (nq,) of the model in which to draw it half transparent, e.g. where a plan ends.
    """

    paths: tuple[PathLine, ...] = ()
    ghosts: tuple[Array, ...] = ()


NO_PREVIEW = Preview()


@dataclass(frozen=True)
class Overlay:
    """State beside the scene at one instant. Empty text and None are not shown.

    Attributes:
        time_s: Simulated time [s].
        title: What runs, e.g. "carry, trial 3 of 100".
        mode: The mode in force: moveit, teleop, policy, impedance.
        source: The source whose commands reach the motors.
        state: State of the arbiter, or the phase of a method without one.
        status: One line for people.
        pinch_n: Pinch force of each hand (left, right) [N].
        internal_n: Squeeze between the hands along the object [N].
        arrows: Forces to draw.
        preview: What is planned.
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
    """A value that a person may set while watching.

    Attributes:
        group: Folder in which it stands, e.g. "left arm".
        label: e.g. "joint 1 [rad]".
        lower: Least value.
        upper: Largest value.
        value: At the beginning.
    """

    group: str
    label: str
    lower: float
    upper: float
    value: float
