"""Phases of handling an object and their parameters, states between them, and motion segments.

Position-driven phases are planned and timed; force-driven ones use object impedance.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Shape
from minidual.config.base import StrictModel
from minidual.motion.timing import PathLimits, resting
from minidual.proof.scene_engines import Verification
from minidual.registry import rows_beside
from minidual.robot.pair import SIDES, Array
from minidual.robot.trajectory import Trajectory

OPEN = 1.0
CLOSED = 0.0
Arms = tuple[str, ...]


class Phase(StrictModel):
    """Parameters of a phase.

    Attributes:
        rise_m: Final height of the hands over their grasps.
        hold_s: Standstill, position-driven.
        force_s: Shortest force ramp, or standstill.
        limits: Of the object or hands; None: the planner's.
    """

    rise_m: float = 0.0
    hold_s: float = 0.0
    force_s: float = 0.0
    limits: PathLimits | None = None


PHASES = {name: Phase(**row) for name, row in rows_beside(__file__).items()}


@dataclass(frozen=True, eq=False)
class State:
    """Arms, hands and objects between two stages.

    Attributes:
        objects: {object: T_world_object (4, 4)}.
        held_by: {arm: T_object_tcp (4, 4)} of holding hands.
        reached: The same of open hands over or at a grasp.
        about: {arm: object} it reached last; the first object if missing.
        openings: (left, right), 0 closed to 1 open.
        rests: Whether what is held is supported.
    """

    q: Array
    objects: Mapping[str, Array]
    held_by: Mapping[str, Array] = field(default_factory=dict)
    reached: Mapping[str, Array] = field(default_factory=dict)
    about: Mapping[str, str] = field(default_factory=dict)
    openings: tuple[float, float] = (OPEN, OPEN)
    rests: bool = True

    def object_of(self, arm: str) -> str:
        """Return the name of the object that an arm handles."""
        return self.about.get(arm) or next(iter(self.objects))

    @property
    def closed_chain(self) -> bool:
        """Whether both hands hold one object."""
        return len(self.held_by) == len(SIDES) and len({self.object_of(arm) for arm in SIDES}) == 1

    def opened(self, arms: Iterable[str], opening: float) -> State:
        """Return the state with some hands' opening changed."""
        left, right = (
            opening if arm in arms else now for arm, now in zip(SIDES, self.openings, strict=True)
        )
        return replace(self, openings=(left, right))


@dataclass(frozen=True, eq=False)
class Segment:
    """Motion between two states.

    Attributes:
        scene, verification: Of the proof; None without motion.
        kept_by: Hands that must feel the object first.
        soft: Hands that may touch something with what they hold.
    """

    phase: str
    trajectory: Trajectory
    openings: tuple[float, float]
    scene: PlanningScene | None = None
    verification: Verification | None = None
    kept_by: Arms = ()
    soft: Arms = ()


@dataclass(frozen=True)
class Thing:
    """The handled object: its shape in its own frame."""

    shape: Shape
    upright: bool = False

    def tilt_rad(self, Ts_world_object: Array) -> float:
        """Return the largest tilt at poses (n, 4, 4): of its z axis if upright, else of its y axis."""
        if self.upright:
            return float(np.arccos(np.clip(Ts_world_object[:, 2, 2].min(), -1.0, 1.0)))
        return float(np.arcsin(np.clip(np.abs(Ts_world_object[:, 2, 1]).max(), 0.0, 1.0)))


def still(
    phase: str,
    q: Array,
    duration_s: float,
    openings: tuple[float, float],
    kept_by: Arms = (),
    soft: Arms = (),
) -> Segment:
    """Return a segment that holds the arms at q (n,)."""
    return Segment(phase, resting(q, duration_s, "both_arms"), openings, kept_by=kept_by, soft=soft)


def moved(T: Array, shift_m: Array) -> Array:
    """Return the pose shifted by (3,) [m]."""
    T = np.array(T)
    T[:3, 3] += shift_m
    return T


def raised(T: Array, height_m: float) -> Array:
    """Return the pose raised by a height [m]."""
    return moved(T, np.array([0.0, 0.0, height_m]))
