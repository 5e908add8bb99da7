"""State shown with the scene."""

from typing import NamedTuple

from minidual.robot.pair import Array

ARM_RGB = ((32, 108, 214), (150, 62, 190))
"""Colours of left arm and right arm."""
OBJECT_RGB = (20, 150, 90)
"""Colour of the object."""


ARROW_M_PER_N = 0.0025
"""Length of a drawn force: 40 N are 10 cm."""


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
        paths: Of the hands.
        ghosts: States (nq,) drawn half transparent.
    """

    paths: tuple[PathLine, ...] = ()
    ghosts: tuple[Array, ...] = ()


NO_PREVIEW = Preview()


class Overlay(NamedTuple):
    """State at one instant. Empty text and None are not shown.

    Attributes:
        time_s: Simulated time.
        title: What is running.
        method: What drives a trial.
        mode: Source that may drive.
        source: Source whose commands reach the motors.
        controller: Law that turns commands into torques.
        state: Of the arbiter, and the phase.
        plan: How long a plan takes, and whether it is proven.
        status: Reflex, or why the method stopped itself.
        pinch_n: Of left and right hand.
        internal_n: Squeeze along the object.
        arrows: Forces.
        preview: Plan.
        lines: Further rows, name and text.
        goal: Pose of the goal's mark (7,), position [m] and quaternion wxyz; None: it does not move.
    """

    time_s: float = 0.0
    title: str = ""
    method: str = ""
    mode: str = ""
    source: str = ""
    controller: str = ""
    state: str = ""
    plan: str = ""
    status: str = ""
    pinch_n: tuple[float, float] | None = None
    internal_n: float | None = None
    arrows: tuple[Arrow, ...] = ()
    preview: Preview = NO_PREVIEW
    lines: tuple[tuple[str, str], ...] = ()
    goal: Array | None = None


class Slider(NamedTuple):
    """A value that viewers may set; `group` is its folder in the panel."""

    group: str
    label: str
    lower: float
    upper: float
    value: float
