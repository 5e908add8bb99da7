"""State shown with the scene."""

from typing import NamedTuple

from minidual.robot.pair import Array

ARM_RGB = ((32, 108, 214), (150, 62, 190))
OBJECT_RGB = (20, 150, 90)
"""Colours of left arm, right arm and object."""


class Arrow(NamedTuple):
    """A force [N] at `start` (3,) [m], world frame; rgb 0 to 255."""

    start: Array
    force: Array
    rgb: tuple[int, int, int]


class PathLine(NamedTuple):
    """A polyline (N, 3), N >= 2, world [m]; `name` is unique in its preview."""

    name: str
    points: Array
    rgb: tuple[int, int, int]


class Preview(NamedTuple):
    """A plan. Reuse the object: views redraw only another one.

    Attributes:
        ghosts: States (nq,) drawn half transparent.
    """

    paths: tuple[PathLine, ...] = ()
    ghosts: tuple[Array, ...] = ()


NO_PREVIEW = Preview()


class Overlay(NamedTuple):
    """State at one instant. Empty text and None are not shown.

    Attributes:
        mode, source: What may drive, and what reaches the motors.
        state: Of the arbiter, and the phase.
        internal_n: Squeeze along the object.
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


class Slider(NamedTuple):
    """A value that viewers may set; `group` is its folder."""

    group: str
    label: str
    lower: float
    upper: float
    value: float
