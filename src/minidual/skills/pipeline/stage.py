"""A stage, what it offers, and the planners it works with."""

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
    """A timed motion does not pass the proof."""

    reason = "not_free"


@dataclass(frozen=True)
class Failure:
    """Why one candidate failed: a short word to count by, and the message with names and numbers."""

    reason: str
    message: str


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way through a stage.

    Attributes:
        label: What distinguishes it, for people.
        cost: Preference; the sum over the stages orders the search.
        end: State after it.
        segments: What is driven.
    """

    label: str
    cost: float
    end: State
    segments: tuple[Segment, ...] = ()


Offer = Candidate | Failure
"""What a stage yields, one after the other, the preferred ones first."""


@dataclass(frozen=True)
class Gap:
    """The distance that the arms keep from each other.

    Attributes:
        distance: Returns (pair of links, distance [m]) of a posture (n,).
        least_m: Nearer is a failure.
    """

    distance: Callable[[Array], tuple[str, float]]
    least_m: float

    def failure(self, segments: Iterable[Segment]) -> Failure | None:
        """Return what comes too near on moving segments, sampled every 5 ms, or None."""
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
    """Planners and scene that all stages of one search share.

    Attributes:
        around: What stands there beside the object.
        thing: The object.
        planner: Free motions.
        seed: Of every random choice.
        gap: Distance between the arms that every motion keeps, or None.
    """

    around: PlanningScene
    thing: Thing
    planner: Planner
    seed: int = 0
    gap: Gap | None = None

    @cached_property
    def linear(self) -> LinearPlanner:
        """Straight motions of hands."""
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
        """Return the planning scene of a state; see `scene_of`."""
        return scene_of(self.robot, self.around, self.thing, state, touching=touching, resting=resting)

    def rng(self, *key: int) -> np.random.Generator:
        """Return the generator of random numbers of one purpose."""
        return np.random.default_rng([self.seed, *key])

    def tips(self, q: Array) -> dict[str, Array]:
        """Return {arm: T_world_tcp (4, 4)} of a posture (n,)."""
        return dict(zip(SIDES, self.planner.kinematics.tcp_poses(q), strict=True))

    def proven(self, phase: str, motion: Trajectory, state: State, scene: PlanningScene, **more: Array) -> Segment:
        """Return the segment of a motion, proven in a scene.

        Raises:
            NotFreeError: It is not free.
        """
        proof = self.planner.engines(scene).verifier.verify(motion)
        if not proof.ok:
            raise NotFreeError(f"the path is not free: {proof.reason}")
        return Segment(phase, motion, state.openings, scene, proof, **more)


class Stage(ABC):
    """One step of a task: goes on from the state before it.

    Attributes:
        name: In the record; distinct within a pipeline.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    @abstractmethod
    def offers(self, start: State, tools: Tools) -> Iterator[Offer]:
        """Yield candidates that begin at `start`, and failures, the preferred candidates first."""


def failure(error: PlanningError, label: str = "") -> Failure:
    """Return the failure that an error of a planner stands for."""
    return Failure(error.reason, f"{label}: {error.message}" if label else error.message)


def group_of(arms: Iterable[str]) -> str:
    """Return the planning group that moves these arms."""
    named = [arm for arm in SIDES if arm in arms]
    return "both_arms" if len(named) == len(SIDES) else f"{named[0]}_arm"
