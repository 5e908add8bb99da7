"""Stages, their offers, and the planners of a search."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.collision.scene import PlanningScene
from minidual.motion.api import Planner
from minidual.motion.held.planner import HeldPlanner
from minidual.motion.linear import LinearPlanner
from minidual.robot.pair import SIDES, Array, Robot
from minidual.robot.trajectory import Trajectory
from minidual.skills.pipeline.state import Segment, State, Thing, scene_of

_GAP_STEP_S = 0.005


class NotFreeError(PlanningError):
    """A timed motion fails its proof."""

    reason = "not_free"


@dataclass(frozen=True)
class Failure:
    """A failed candidate: `reason` to count by, `message` with details."""

    reason: str
    message: str


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way through a stage to state `end`; summed costs order the search."""

    label: str
    cost: float
    end: State
    segments: tuple[Segment, ...] = ()


Offer = Candidate | Failure
"""What a stage yields, preferred first."""


@dataclass(frozen=True)
class Gap:
    """Minimum arm distance; `distance` maps a posture (n,) to (link pair, distance [m])."""

    distance: Callable[[Array], tuple[str, float]]
    least_m: float

    def failure(self, segments: Iterable[Segment]) -> Failure | None:
        """Return the failure of moving segments, sampled every 5 ms."""
        found: list[tuple[float, str]] = []
        for motion in (s.trajectory for s in segments if s.verification is not None):
            for q in motion.sample_many(np.arange(0.0, motion.duration_s + _GAP_STEP_S, _GAP_STEP_S, dtype=float))[0]:
                pair, gap = self.distance(q)
                found.append((gap, pair))
        gap, pair = min(found, default=(np.inf, ""))
        if gap >= self.least_m:
            return None
        return Failure("arms_too_close", f"{pair} come to {1e3 * gap:.1f} mm; they must keep {1e3 * self.least_m:.0f}")


@dataclass
class Tools:
    """Planners and scene of a search; `around` holds the other obstacles."""

    around: PlanningScene
    thing: Thing
    planner: Planner
    seed: int = 0
    gap: Gap | None = None

    @cached_property
    def linear(self) -> LinearPlanner:
        """Straight hand motions."""
        return LinearPlanner(kinematics=self.planner.kinematics)

    @cached_property
    def holder(self) -> HeldPlanner:
        """Motions of an object in both hands."""
        return HeldPlanner(self.planner)

    @property
    def robot(self) -> Robot:
        """The arms."""
        return self.planner.robot

    def scene(self, state: State, *, touching: Iterable[str] = (), resting: bool = False) -> PlanningScene:
        """Return a state's planning scene; see `scene_of`."""
        return scene_of(self.robot, self.around, self.thing, state, touching=touching, resting=resting)

    def rng(self, *key: int) -> np.random.Generator:
        """Return the generator of a purpose."""
        return np.random.default_rng([self.seed, *key])

    def tips(self, q: Array) -> dict[str, Array]:
        """Return {arm: T_world_tcp (4, 4)} of a posture (n,)."""
        return dict(zip(SIDES, self.planner.kinematics.tcp_poses(q), strict=True))

    def proven(self, phase: str, motion: Trajectory, state: State, scene: PlanningScene, **more: Array) -> Segment:
        """Verify a motion and return its segment.

        Raises:
            NotFreeError: The proof failed.
        """
        proof = self.planner.engines(scene).verifier.verify(motion)
        if not proof.ok:
            raise NotFreeError(f"the path is not free: {proof.reason}")
        return Segment(phase, motion, state.openings, scene, proof, **more)


class Stage(ABC):
    """One step of a task; `name` is unique in a pipeline."""

    def __init__(self, name: str) -> None:
        self.name = name

    @abstractmethod
    def offers(self, start: State, tools: Tools) -> Iterator[Offer]:
        """Yield candidates from `start`, preferred first, and failures."""


def failure(error: PlanningError, label: str = "") -> Failure:
    """Convert a planner error to a failure."""
    return Failure(error.reason, f"{label}: {error.message}" if label else error.message)


def group_of(arms: Iterable[str]) -> str:
    """Return these arms' planning group."""
    named = [arm for arm in SIDES if arm in arms]
    return "both_arms" if len(named) == len(SIDES) else f"{named[0]}_arm"
