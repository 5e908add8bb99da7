"""Stages, their offers, and the planners of a search."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.collision.scene import TABLE, PlanningScene
from minidual.motion.api import Planner
from minidual.motion.held.query import placed, scene_holding
from minidual.robot.pair import Array
from minidual.robot.trajectory import Trajectory
from minidual.skills.states import Segment, State, Thing

_GAP_STEP_S = 0.005
_LIMIT_ROOM_RAD = 0.003
"""Arms stray from a plan by 1 to 2 mrad."""


class CandidateError(PlanningError):
    """A failed candidate: `reason` to count by, `message` with details."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way through a stage to state `end`; summed costs order the search."""

    label: str
    cost: float
    end: State
    segments: tuple[Segment, ...] = ()


Offer = Candidate | CandidateError
"""Results of a stage, preferred first."""


@dataclass(frozen=True)
class Gap:
    """Minimum arm distance.

    Attributes:
        distance: From a posture (n,) to (link pair, distance [m]).
        reach_m: (n,), see `Reach`.
        least_m: Distance to keep.
    """

    distance: Callable[[Array], tuple[str, float]]
    reach_m: Array
    least_m: float

    def check(self, segments: Sequence[Segment]) -> None:
        """Check moving segments, for distance every 5 ms where it could close.

        Raises:
            CandidateError: The arms come closer, or a joint comes within 3 mrad of a limit.
        """
        proofs = [segment.verification for segment in segments if segment.verification is not None]
        room_rad = min((proof.limit_margin_rad for proof in proofs), default=np.inf)
        if room_rad < _LIMIT_ROOM_RAD:
            raise CandidateError(
                "at_limit",
                f"a joint comes to {1e3 * room_rad:.1f} mrad from its limit; "
                "the supervisor stops it there",
            )
        pair = ""
        gap_m = np.inf
        for segment in segments:
            if segment.verification is not None:
                segment_pair, segment_gap_m = self._nearest(segment.trajectory)
                if (segment_gap_m, segment_pair) < (gap_m, pair):
                    pair = segment_pair
                    gap_m = segment_gap_m
        if gap_m < self.least_m:
            raise CandidateError(
                "arms_too_close",
                f"{pair} come to {1e3 * gap_m:.1f} mm; they must keep {1e3 * self.least_m:.0f}",
            )

    def _nearest(self, motion: Trajectory) -> tuple[str, float]:
        """Return the link pair that comes closest in a motion, and its distance [m].

        After a sample, both arms together must go as far as the gap is wide before it can close.
        """
        times: Array = np.arange(0.0, motion.duration_s + _GAP_STEP_S, _GAP_STEP_S, dtype=float)
        q = motion.sample_many(times).q
        steps_m = np.abs(np.diff(q, axis=0)) @ self.reach_m
        way_m = np.r_[0.0, np.cumsum(steps_m)]
        nearest_pair = ""
        nearest_m = np.inf
        k = 0
        while k < len(q):
            pair, distance_m = self.distance(q[k])
            if (distance_m, pair) < (nearest_m, nearest_pair):
                nearest_pair = pair
                nearest_m = distance_m
            free_m = way_m[k] + distance_m - self.least_m
            k = max(k + 1, int(np.searchsorted(way_m, free_m)))
        return nearest_pair, nearest_m


@dataclass(frozen=True)
class Tools:
    """Planner and scene of a search.

    Attributes:
        around: Scene with the obstacles that are not handled.
        things: Handled objects by name.
        planner: Plans free motions.
        seed: Of the search.
        gap: Distance that the arms keep; None keeps what the planner keeps.
        by_force: Whether held objects may touch something under impedance, not by position.
        fingers_s: Time in which open fingers come to the narrowest thing.
    """

    around: PlanningScene
    things: Mapping[str, Thing]
    planner: Planner
    seed: int = 0
    gap: Gap | None = None
    by_force: bool = False
    fingers_s: float = 0.5

    def scene(
        self,
        state: State,
        *,
        touching: Collection[str] = (),
        resting: bool = False,
    ) -> PlanningScene:
        """Return the scene: an object is an obstacle, or attached to its first holder.

        Args:
            state: Where the objects are, and who holds them.
            touching: Arms whose hands may touch their objects.
            resting: Whether held objects may touch what they rest on.
        """
        scene = self.around
        for name, thing in self.things.items():
            holders = {arm: T for arm, T in state.held_by.items() if state.object_of(arm) == name}
            near = [arm for arm in touching if state.object_of(arm) == name]
            if holders:
                rests_on = (TABLE.name,) if resting else ()
                scene = scene_holding(scene, thing.shape, holders, rests_on=rests_on, touching=near)
            else:
                scene = scene.with_obstacles(placed(thing.shape, state.objects[name]))
                scene = self._with_hands_at(scene, name, near)
        return scene

    def _with_hands_at(
        self,
        scene: PlanningScene,
        name: str,
        arms: Sequence[str],
    ) -> PlanningScene:
        """Return the scene in which the hands of some arms may touch an object."""
        for arm in arms:
            for link in self.around.robot.hand_links(arm):
                reason = "the hand is at the object to hold it or let it go"
                scene = scene.allowing(name, link, reason)
        return scene


@dataclass(frozen=True)
class Stage:
    """One step of a task; `name` is unique in a pipeline.

    Attributes:
        offers: Yields candidates from a state, preferred first, and failures. A PlanningError is a
            failure, after which nothing more is offered.
    """

    name: str
    offers: Callable[[State, Tools], Iterator[Offer]]


def candidate_error(error: PlanningError, label: str) -> CandidateError:
    """Return a planner error as the failure of a labelled candidate."""
    return CandidateError(error.reason, f"{label}: {error.message}")
