"""Stage of the held object: lift, carry, lower."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.config.seeds import stream
from minidual.motion.held.planner import HeldPlanner
from minidual.motion.held.query import HeldQuery
from minidual.motion.pose_goals import pose_goals
from minidual.robot.pair import SIDES, Array, group_of, inverse
from minidual.skills.phases import PHASES, Segment, State, raised
from minidual.skills.pipeline.hands import free, straight
from minidual.skills.pipeline.stage import Candidate, CandidateError, Offer, Tools, candidate_error

_OTHER_HEIGHTS_M = (0.06, 0.2)
_BUDGET_S = 2.0
_TILT_EVERY = 10
Way = Callable[[str, Mapping[str, Array], State, Tools], Segment]
"""Moves the held objects to poses in a phase."""


@dataclass(frozen=True, eq=False)
class Place:
    """Target poses (4, 4) of the held objects; `rests`: they are supported there."""

    label: str
    objects: Mapping[str, Array]
    cost: float = 0.0
    rests: bool = True


class Carry:
    """Bring the held objects to one of several places.

    Two hands on one object first try one motion without a stop. Then: straight up, across freely (else straight first), straight
    down. A free motion may tilt the object by `tilt_max_rad`.
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
        # as low as the task allows, where the arms reach no higher
        self._heights = tuple(dict.fromkeys((lift_m, *(max(h, min_m) for h in _OTHER_HEIGHTS_M))))

    def offers(self, start: State, tools: Tools) -> Iterator[Offer]:
        """Yield ways to every place."""
        if not start.held_by:
            raise CandidateError("not_held", "no hand holds the object")
        both = start.closed_chain
        ways = [(0.2, self._freely)] if both else [(0.0, self._line), (1.0, self._freely)]
        for index, place in enumerate(self._places):
            try:
                self._check(place, index, start, tools)
            except PlanningError as error:
                yield candidate_error(error, place.label)
                continue
            if both and start.rests and place.rests:
                yield self._at_once(place, start, tools)
            for extra, across in ways:
                for rank, height in enumerate(self._heights):
                    yield self._in_parts(place, height, 0.2 * rank + extra, across, start, tools)

    def _check(self, place: Place, index: int, start: State, tools: Tools) -> None:
        group = group_of(start.held_by)
        hands = _hands_at(place.objects, start)
        engines = tools.planner.engines(tools.scene(start, resting=place.rests))
        rng = stream(tools.seed, "pipeline/place", index)
        pose_goals(group, start.q, hands, engines, rng, tools.planner.config.ik_restarts_n)

    def _at_once(self, place: Place, start: State, tools: Tools) -> Offer:
        height = self._heights[0]
        begin, end = (poses[start.object_of(SIDES[0])] for poses in (start.objects, place.objects))
        try:
            segment = self._in_both_hands(
                [begin, raised(begin, height), raised(end, height), end],
                start,
                tools,
            )
        except PlanningError as error:
            return candidate_error(error, f"{place.label}, at once")
        return Candidate(place.label, place.cost, _at(place, start, segment), (segment,))

    def _in_parts(
        self,
        place: Place,
        height: float,
        cost: float,
        across: Way,
        start: State,
        tools: Tools,
    ) -> Offer:
        label = f"{place.label}, {100 * height:.0f} cm up, {'straight' if across == self._line else 'round'}"
        held = {start.object_of(arm): start.objects[start.object_of(arm)] for arm in start.held_by}
        lifted, above = (
            {name: raised(T, height) for name, T in poses.items()}
            for poses in (held, place.objects)
        )
        legs = [("lift", lifted, self._line)] if start.rests else []
        legs += [("carry", above if place.rests else place.objects, across)]
        legs += [("lower", place.objects, self._line)] if place.rests else []
        state = start
        segments = list[Segment]()
        for phase, goals, way in legs:
            try:
                segments.append(way(phase, goals, state, tools))
            except PlanningError as error:
                return candidate_error(error, f"{label}, {phase}")
            state = replace(
                state,
                q=segments[-1].trajectory.q[-1],
                objects={**state.objects, **goals},
            )
        return Candidate(label, place.cost + cost, _at(place, state, segments[-1]), tuple(segments))

    def _line(self, phase: str, goals: Mapping[str, Array], state: State, tools: Tools) -> Segment:
        if state.closed_chain:
            name = state.object_of(SIDES[0])
            return self._in_both_hands([state.objects[name], goals[name]], state, tools, phase)
        scene = tools.scene(state, resting=phase != "carry")
        segment = straight(tools, phase, state, _hands_at(goals, state), scene)
        return replace(segment, soft=tuple(state.held_by)) if phase == "lower" else segment

    def _in_both_hands(
        self,
        way: list[Array],
        state: State,
        tools: Tools,
        phase: str = "carry",
    ) -> Segment:
        scene = tools.scene(state, resting=True)
        path = HeldPlanner(tools.planner).follow(
            state.q,
            way,
            _grasps(state),
            along=PHASES[phase].limits,
            scene=scene,
        )
        return Segment(phase, path, state.openings, scene, path.verification)

    def _freely(
        self,
        phase: str,
        goals: Mapping[str, Array],
        state: State,
        tools: Tools,
    ) -> Segment:
        scene = tools.scene(state)
        budget_s = _BUDGET_S
        if state.closed_chain:
            query = HeldQuery(
                state.q,
                goals[state.object_of(SIDES[0])],
                _grasps(state),
                scene,
                tools.seed,
            )
            motion = HeldPlanner(tools.planner).plan(query, budget_s)
            segment = Segment(phase, motion, state.openings, scene, motion.verification)
            ways = {SIDES[0]: motion.Ts_world_object}
        else:
            group = group_of(state.held_by)
            targets = _hands_at(goals, state)
            plan = tools.planner.plan_to_poses(
                group,
                state.q,
                targets,
                scene=scene,
                seed=tools.seed,
                budget_s=budget_s,
            )
            segment = free(tools, phase, state, plan, scene)
            tips = np.array(
                [tools.planner.kinematics.tcp_poses(q) for q in plan.trajectory.q[::_TILT_EVERY]],
            )
            ways = {arm: tips[:, SIDES.index(arm)] @ inverse(T) for arm, T in state.held_by.items()}
        tilt = max(tools.things[state.object_of(arm)].tilt_rad(Ts) for arm, Ts in ways.items())
        if tilt > self._tilt_max_rad:
            most = f"at most {self._tilt_max_rad:.2f}"
            raise CandidateError("tilted", f"the object tilts by {tilt:.2f} rad on the way; {most}")
        return segment


def _grasps(state: State) -> tuple[Array, Array]:
    return state.held_by[SIDES[0]], state.held_by[SIDES[1]]


def _hands_at(objects: Mapping[str, Array], state: State) -> dict[str, Array]:
    """Return {arm: T_world_tcp (4, 4)} of the holding hands, their objects at these poses."""
    return {arm: objects[state.object_of(arm)] @ T for arm, T in state.held_by.items()}


def _at(place: Place, state: State, last: Segment) -> State:
    return replace(
        state,
        q=last.trajectory.q[-1],
        objects={**state.objects, **place.objects},
        rests=place.rests,
    )
