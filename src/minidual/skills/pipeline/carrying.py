"""Stage of the held object: lift, carry, lower."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.config.seeds import stream
from minidual.motion.held.planner import HeldPlanner
from minidual.motion.held.query import HeldQuery
from minidual.motion.pose_goals import pose_goals
from minidual.robot.pair import SIDES, Array, group_of, inverse
from minidual.skills.phases import PHASES
from minidual.skills.pipeline.motions import free, straight
from minidual.skills.pipeline.stage import Candidate, CandidateError, Offer, Tools, candidate_error
from minidual.skills.states import Segment, State, raised

_OTHER_HEIGHTS_M = (0.06, 0.2)
_BUDGET_CHECKS_N = 120_000
"""Work of one free motion: 3 to 10 s of a core."""
_TILT_EVERY = 10
"""Samples from one check of the tilt to the next."""

type Poses = Mapping[str, Array]
"""T_world_object (4, 4) by name."""
type Way = Callable[[str, Poses, State, Tools], Segment]
"""Moves the held objects to poses in a phase."""


@dataclass(frozen=True, eq=False)
class Place:
    """Target poses (4, 4) of the held objects; `rests`: they are supported there."""

    label: str
    objects: Poses
    cost: float = 0.0
    rests: bool = True


class _Route(NamedTuple):
    """A route across: height, way and cost."""

    height_m: float
    across: Way
    shape: str
    cost: float


class _Leg(NamedTuple):
    """One motion of a route: its phase, the poses at its end, and the way there."""

    phase: str
    goals: Poses
    way: Way


class Carry:
    """Bring the held objects to one of several places.

    Two hands on one object first try one motion without a stop. Then: straight up, across freely
    (or straight first), straight down.

    Args:
        places: Targets.
        lift_m: Height of the lift.
        tilt_max_rad: Tilt of the object during a free motion.
        min_m: Least height of the lift where the arms reach no higher.
    """

    def __init__(
        self,
        places: Sequence[Place],
        lift_m: float,
        tilt_max_rad: float = np.pi,
        min_m: float = 0.0,
    ) -> None:
        self._tilt_max_rad = tilt_max_rad
        self._places = sorted(places, key=lambda place: place.cost)
        others_m = [max(height_m, min_m) for height_m in _OTHER_HEIGHTS_M]
        self._heights_m = tuple(dict.fromkeys([lift_m, *others_m]))

    def offers(self, start: State, tools: Tools) -> Iterator[Offer]:
        """Yield ways to every place."""
        if not start.held_by:
            raise CandidateError("not_held", "no hand holds the object")
        for index, place in enumerate(self._places):
            try:
                self._check(place, index, start, tools)
            except PlanningError as error:
                yield candidate_error(error, place.label)
                continue
            if start.closed_chain and start.rests and place.rests:
                yield self._at_once(place, start, tools)
            for route in self._routes(start):
                yield self._in_parts(place, route, start, tools)

    def _routes(self, start: State) -> Iterator[_Route]:
        """Yield routes, preferred first."""
        if start.closed_chain:
            ways = [(self._freely, "round", 0.2)]
        else:
            ways = [(self._line, "straight", 0.0), (self._freely, "round", 1.0)]
        for across, shape, cost in ways:
            for rank, height_m in enumerate(self._heights_m):
                yield _Route(height_m, across, shape, 0.2 * rank + cost)

    def _check(self, place: Place, index: int, start: State, tools: Tools) -> None:
        """Raise PlanningError unless the hands reach a place."""
        rng = stream(tools.seed, "pipeline/place", index)
        pose_goals(
            group_of(start.held_by),
            start.q,
            _hands_at(place.objects, start),
            tools.planner.engines(tools.scene(start, resting=place.rests)),
            rng,
            tools.planner.config.ik_restarts_n,
        )

    def _at_once(self, place: Place, start: State, tools: Tools) -> Offer:
        """Offer lift, carry and lower as one motion of both hands."""
        height_m = self._heights_m[0]
        name = start.object_of(SIDES[0])
        begin = start.objects[name]
        end = place.objects[name]
        way = [begin, raised(begin, height_m), raised(end, height_m), end]
        try:
            segment = self._in_both_hands(way, start, tools, "carry")
        except PlanningError as error:
            return candidate_error(error, f"{place.label}, at once")
        return Candidate(place.label, place.cost, _at(place, start, segment), (segment,))

    def _in_parts(self, place: Place, route: _Route, start: State, tools: Tools) -> Offer:
        """Offer lift, carry and lower one after another."""
        label = f"{place.label}, {100 * route.height_m:.0f} cm up, {route.shape}"
        state = start
        segments: list[Segment] = []
        for leg in self._legs(place, route, start):
            try:
                segment = leg.way(leg.phase, leg.goals, state, tools)
            except PlanningError as error:
                return candidate_error(error, f"{label}, {leg.phase}")
            segments.append(segment)
            state = replace(
                state,
                q=segment.trajectory.q[-1],
                objects={**state.objects, **leg.goals},
            )
        end = _at(place, state, segments[-1])
        return Candidate(label, place.cost + route.cost, end, tuple(segments))

    def _legs(self, place: Place, route: _Route, start: State) -> list[_Leg]:
        """Return lift and lower as far as the objects rest before and after, and the carry."""
        names = [start.object_of(arm) for arm in start.held_by]
        lifted = {name: raised(start.objects[name], route.height_m) for name in names}
        above = {name: raised(T, route.height_m) for name, T in place.objects.items()}
        legs: list[_Leg] = []
        if start.rests:
            legs.append(_Leg("lift", lifted, self._line))
        legs.append(_Leg("carry", above if place.rests else place.objects, route.across))
        if place.rests:
            legs.append(_Leg("lower", place.objects, self._line))
        return legs

    # Ways --------------------------------------------------------------------------------------

    def _line(self, phase: str, goals: Poses, state: State, tools: Tools) -> Segment:
        """Move the objects straight."""
        if state.closed_chain:
            name = state.object_of(SIDES[0])
            return self._in_both_hands([state.objects[name], goals[name]], state, tools, phase)
        scene = tools.scene(state, resting=phase != "carry")
        segment = straight(tools, phase, state, _hands_at(goals, state), scene)
        if phase != "lower":
            return segment
        return replace(segment, soft=tuple(state.held_by))

    def _in_both_hands(
        self,
        way: list[Array],
        state: State,
        tools: Tools,
        phase: str,
    ) -> Segment:
        """Move an object in both hands along poses (4, 4)."""
        scene = tools.scene(state, resting=True)
        path = HeldPlanner(tools.planner).follow(
            state.q,
            way,
            _grasps(state),
            along=PHASES[phase].limits,
            scene=scene,
        )
        return Segment(phase, path, state.openings, scene, path.verification)

    def _freely(self, phase: str, goals: Poses, state: State, tools: Tools) -> Segment:
        """Search a motion in which the objects tilt by no more than allowed."""
        if state.closed_chain:
            segment, ways = self._search_in_both_hands(phase, goals, state, tools)
        else:
            segment, ways = self._search_in_each_hand(phase, goals, state, tools)
        tilts = [
            tools.things[state.object_of(arm)].tilt_rad(Ts_world_object)
            for arm, Ts_world_object in ways.items()
        ]
        tilt = max(tilts)
        if tilt > self._tilt_max_rad:
            raise CandidateError(
                "tilted",
                f"the object tilts by {tilt:.2f} rad on the way; at most {self._tilt_max_rad:.2f}",
            )
        return segment

    def _search_in_both_hands(
        self,
        phase: str,
        goals: Poses,
        state: State,
        tools: Tools,
    ) -> tuple[Segment, dict[str, Array]]:
        """Return a motion, and the object's poses (m, 4, 4) by an arm."""
        scene = tools.scene(state)
        goal = goals[state.object_of(SIDES[0])]
        query = HeldQuery(state.q, goal, _grasps(state), scene, tools.seed)
        motion = HeldPlanner(tools.planner).plan(query, budget_checks_n=_BUDGET_CHECKS_N)
        segment = Segment(phase, motion, state.openings, scene, motion.verification)
        return segment, {SIDES[0]: motion.Ts_world_object}

    def _search_in_each_hand(
        self,
        phase: str,
        goals: Poses,
        state: State,
        tools: Tools,
    ) -> tuple[Segment, dict[str, Array]]:
        """Return a motion, and the objects' poses (m, 4, 4) by arm."""
        scene = tools.scene(state)
        plan = tools.planner.plan_to_poses(
            group_of(state.held_by),
            state.q,
            _hands_at(goals, state),
            scene=scene,
            seed=tools.seed,
            budget_checks_n=_BUDGET_CHECKS_N,
        )
        segment = free(tools, phase, state, plan, scene)
        sampled = plan.trajectory.q[::_TILT_EVERY]
        tips = np.array([tools.planner.kinematics.tcp_poses(q) for q in sampled])
        ways = {}
        for arm, T_object_tcp in state.held_by.items():
            ways[arm] = tips[:, SIDES.index(arm)] @ inverse(T_object_tcp)
        return segment, ways


def _grasps(state: State) -> tuple[Array, Array]:
    """Return the left and right T_object_tcp (4, 4)."""
    left, right = SIDES
    return state.held_by[left], state.held_by[right]


def _hands_at(objects: Poses, state: State) -> dict[str, Array]:
    """Return {arm: T_world_tcp (4, 4)} of the holding hands, their objects at these poses."""
    return {arm: objects[state.object_of(arm)] @ T for arm, T in state.held_by.items()}


def _at(place: Place, state: State, last: Segment) -> State:
    """Return the state with the objects at a place, after the last segment."""
    return replace(
        state,
        q=last.trajectory.q[-1],
        objects={**state.objects, **place.objects},
        rests=place.rests,
    )
