"""States of arms, hands and objects, and the motion segments between them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Shape
from minidual.motion.timing import resting
from minidual.proof.scene_engines import Verification
from minidual.robot.pair import SIDES, Array
from minidual.robot.trajectory import Trajectory

OPEN = 1.0
CLOSED = 0.0
Arms = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class State:
    """Arms, hands and objects between two stages.

    Attributes:
        q: Joints (n,) [rad].
        objects: {object: T_world_object (4, 4)}.
        held_by: {arm: T_object_tcp (4, 4)} of holding hands.
        reached: The same of open hands over or at a grasp.
        handled: {arm: object} it reached last; the first object if missing.
        openings: (left, right), 0 closed to 1 open.
        rests: Whether the held object is supported.
    """

    q: Array
    objects: Mapping[str, Array]
    held_by: Mapping[str, Array] = field(default_factory=dict)
    reached: Mapping[str, Array] = field(default_factory=dict)
    handled: Mapping[str, str] = field(default_factory=dict)
    openings: tuple[float, float] = (OPEN, OPEN)
    rests: bool = True

    def object_of(self, arm: str) -> str:
        """Return the name of the object that an arm handles."""
        if arm in self.handled:
            return self.handled[arm]
        return next(iter(self.objects))

    @property
    def closed_chain(self) -> bool:
        """Whether both hands hold one object."""
        both_hold = len(self.held_by) == len(SIDES)
        return both_hold and len({self.object_of(arm) for arm in SIDES}) == 1

    def opened(self, arms: Iterable[str], opening: float) -> State:
        """Return the state with the opening of some hands changed."""
        left, right = (
            opening if arm in arms else present
            for arm, present in zip(SIDES, self.openings, strict=True)
        )
        return replace(self, openings=(left, right))


@dataclass(frozen=True, eq=False)
class Segment:
    """Motion between two states.

    Attributes:
        phase: Name of the phase.
        trajectory: Of both arms.
        openings: (left, right), 0 closed to 1 open.
        scene: Scene of the proof; None without motion.
        verification: Result of the proof; None without motion.
        kept_by: Hands that must feel the object before the segment begins.
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
    """A handled object: its shape in its own frame."""

    shape: Shape
    upright: bool = False

    def tilt_rad(self, Ts_world_object: Array) -> float:
        """Return the largest tilt at poses (n, 4, 4): of its z axis if upright, else of its y."""
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
    trajectory = resting(q, duration_s, "both_arms")
    return Segment(phase, trajectory, openings, kept_by=kept_by, soft=soft)


def moved(T: Array, shift_m: Array) -> Array:
    """Return the pose (4, 4) shifted by (3,) [m]."""
    T = np.array(T)
    T[:3, 3] += shift_m
    return T


def raised(T: Array, height_m: float) -> Array:
    """Return the pose (4, 4) raised by a height [m]."""
    return moved(T, np.array([0.0, 0.0, height_m]))
