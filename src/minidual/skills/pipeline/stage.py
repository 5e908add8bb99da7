"""Stages, their offers, and the planners of a search."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.collision.scene import TABLE, PlanningScene
from minidual.motion.api import Planner
from minidual.motion.held.query import placed, scene_holding
from minidual.robot.pair import Array
from minidual.skills.phases import Segment, State, Thing

_GAP_STEP_S = 0.005
_LIMIT_ROOM_RAD = 0.003  # arms stray from a plan by 1 to 2 mrad


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
"""What a stage yields, preferred first."""


@dataclass(frozen=True)
class Gap:
    """Minimum arm distance.

    Attributes:
        distance: Posture (n,) -> (link pair, distance [m]).
        reach_m: (n,), see `Reach`.
    """

    distance: Callable[[Array], tuple[str, float]]
    reach_m: Array
    least_m: float

    def check(self, segments: Sequence[Segment]) -> None:
        """Check moving segments, for distance every 5 ms where it could close.

        Raises:
            CandidateError: The arms come closer, or a joint comes within 3 mrad of a limit.
        """
        room = min(
            (s.verification.limit_margin_rad for s in segments if s.verification),
            default=np.inf,
        )
        if room < _LIMIT_ROOM_RAD:
            near = f"a joint comes to {1e3 * room:.1f} mrad from its limit; the supervisor stops it there"
            raise CandidateError("at_limit", near)
        found = [("", np.inf)]
        for motion in (s.trajectory for s in segments if s.verification is not None):
            q = motion.sample_many(
                np.arange(0.0, motion.duration_s + _GAP_STEP_S, _GAP_STEP_S, dtype=float),
            )[0]
            way_m = np.r_[0.0, np.cumsum(np.abs(np.diff(q, axis=0)) @ self.reach_m)]
            k = 0
            while k < len(
                q,
            ):  # until both arms together have gone further than the gap is wide, it lasts
                found.append(self.distance(q[k]))
                k = max(k + 1, int(np.searchsorted(way_m, way_m[k] + found[-1][1] - self.least_m)))
        pair, gap = min(found, key=lambda near: (near[1], near[0]))
        if gap < self.least_m:
            keep = f"they must keep {1e3 * self.least_m:.0f}"
            raise CandidateError("arms_too_close", f"{pair} come to {1e3 * gap:.1f} mm; {keep}")


@dataclass(frozen=True)
class Tools:
    """Planner and scene of a search.

    Attributes:
        around: With the other obstacles.
        things: By name.
        by_force: For impedance, not position.
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

        Hands of the arms `touching` may touch their objects; `resting` lets held objects touch what they rest on.
        """
        scene = self.around
        for name, thing in self.things.items():
            holders = {arm: T for arm, T in state.held_by.items() if state.object_of(arm) == name}
            near = [arm for arm in touching if state.object_of(arm) == name]
            if holders:
                rests_on = (TABLE.name,) if resting else ()
                scene = scene_holding(scene, thing.shape, holders, rests_on=rests_on, touching=near)
                continue
            scene = scene.with_obstacles(placed(thing.shape, state.objects[name]))
            for link in (link for arm in near for link in self.around.robot.hand_links(arm)):
                scene = scene.allowing(
                    name,
                    link,
                    "the hand is at the object to hold it or let it go",
                )
        return scene


@dataclass(frozen=True)
class Stage:
    """One step of a task; `name` is unique in a pipeline.

    Attributes:
        offers: Yields candidates from a state, preferred first, and failures. A PlanningError is a failure, after which
            nothing more is offered.
    """

    name: str
    offers: Callable[[State, Tools], Iterator[Offer]]


def candidate_error(error: PlanningError, label: str) -> CandidateError:
    """Return a planner error as the failure of a labelled candidate."""
    return CandidateError(error.reason, f"{label}: {error.message}")
