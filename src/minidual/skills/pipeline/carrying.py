"""Stages of the held object: lift it, choose where it goes, bring it there, put it down."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from minidual.collision.errors import ClosedChainError, PlanningError
from minidual.motion.held_path import ObjectLimits
from minidual.motion.held_query import HeldQuery
from minidual.motion.linear import TipLimits
from minidual.robot.constants import ARMS, Array
from minidual.skills.pipeline.stage import Candidate, Failure, Forward, Offer, Tools, group_of
from minidual.skills.pipeline.state import Segment, State, raised

SLOW = ObjectLimits(speed_m_per_s=0.15, acceleration_m_per_s2=0.6)
"""Lifting off and putting down."""


@dataclass(frozen=True, eq=False)
class Place:
    """One way to put the object down.

    Attributes:
        label: For people.
        T_world_object: Its pose (4, 4) when it stands.
        cost: Preference.
    """

    label: str
    T_world_object: Array
    cost: float = 0.0


class Lift(Forward):
    """Straight up with the object."""

    def __init__(self, name: str = "lift", heights_m: Sequence[float] = (0.12, 0.2, 0.06)) -> None:
        super().__init__(name)
        self._heights = tuple(heights_m)

    def offers(self, start: State, tools: Tools) -> Iterator[Offer]:
        """Yield lifts by every height."""
        for rank, height in enumerate(self._heights):
            label = f"by {height * 100:.0f} cm"
            yield straight_with_object(self.name, label, 0.2 * rank, start, raised(start.T_world_object, height), tools)


class ChoosePlace(Forward):
    """Decide where the object goes; only places that the hands reach and where nothing stands are offered."""

    def __init__(self, name: str, places: Sequence[Place]) -> None:
        super().__init__(name)
        self._places = tuple(sorted(places, key=lambda place: place.cost))

    def offers(self, start: State, tools: Tools) -> Iterator[Offer]:
        """Yield the places that pass; nothing moves."""
        scene = tools.scene(start, resting=True)
        for index, place in enumerate(self._places):
            targets = {arm: place.T_world_object @ T for arm, T in start.held_by.items()}
            try:
                tools.poses.candidates(
                    group_of(start.held_by),
                    start.q,
                    targets,
                    tools.planner.engines(scene).mujoco,
                    tools.rng(2, index),
                    restarts_n=tools.planner.config.ik_restarts_n,
                    candidates_n=1,
                )
            except PlanningError as error:
                yield Failure(error.reason, f"{place.label}: {error.message}")
                continue
            end = replace(start, T_world_place=place.T_world_object)
            yield Candidate(place.label, place.cost, start, end)


class Transport(Forward):
    """Bring the object over its place, round whatever stands in the way."""

    def __init__(
        self, name: str = "transport", heights_m: Sequence[float] = (0.12, 0.06, 0.2), budget_s: float = 2.0
    ) -> None:
        super().__init__(name)
        self._heights, self._budget_s = tuple(heights_m), budget_s

    def offers(self, start: State, tools: Tools) -> Iterator[Offer]:
        """Yield ways to above the place, from several heights over it."""
        if start.T_world_place is None:
            yield Failure("no_place", "no place was chosen before")
            return
        scene = tools.scene(start)
        for rank, height in enumerate(self._heights):
            above = raised(start.T_world_place, height)
            label = f"to {height * 100:.0f} cm over the place"
            try:
                segment = self._carried(start, above, tools)
            except PlanningError as error:
                yield Failure(error.reason, f"{label}: {error.message}")
                continue
            assert segment.trajectory is not None
            end = replace(start, q=segment.trajectory.q[-1], T_world_object=above)
            yield Candidate(label, 0.2 * rank, start, end, (replace(segment, scene=scene),))

    def _carried(self, start: State, above: Array, tools: Tools) -> Segment:
        scene = tools.scene(start)
        if len(start.held_by) == len(ARMS):
            left, right = (start.held_by[arm] for arm in ARMS)
            moved = tools.holder.plan(HeldQuery(start.q, above, left, right, scene, tools.seed), self._budget_s)
            return Segment(
                self.name, moved, start.openings, verification=moved.verification, Ts_world_object=moved.Ts_world_object
            )
        targets = {arm: above @ T for arm, T in start.held_by.items()}
        plan = tools.planner.plan_to_poses(
            group_of(start.held_by), start.q, targets, scene=scene, seed=tools.seed, budget_s=self._budget_s
        )
        return Segment(self.name, plan.trajectory, start.openings, verification=plan.verification)


class PutDown(Forward):
    """Straight down to the chosen place."""

    def offers(self, start: State, tools: Tools) -> Iterator[Offer]:
        """Yield the one way down."""
        if start.T_world_place is None:
            yield Failure("no_place", "no place was chosen before")
            return
        yield straight_with_object(self.name, "", 0.0, start, start.T_world_place, tools)


def straight_with_object(stage: str, label: str, cost: float, start: State, T_world_goal: Array, tools: Tools) -> Offer:
    """Return the candidate that moves the held object straight to a pose, which it may touch what it rests on."""
    scene = tools.scene(start, resting=True)
    try:
        if len(start.held_by) == len(ARMS):
            left, right = (start.held_by[arm] for arm in ARMS)
            moved = tools.carrier.plan(start.q, [start.T_world_object, T_world_goal], left, right, object_limits=SLOW)
            proof = tools.planner.engines(scene).verifier.verify(moved)
            if not proof.ok:
                raise ClosedChainError(f"the carried path is not free: {proof.reason}")
            segment = Segment(
                stage, moved, start.openings, scene=scene, verification=proof, Ts_world_object=moved.Ts_world_object
            )
        else:
            targets = {arm: T_world_goal @ T for arm, T in start.held_by.items()}
            move = tools.linear.plan(
                group_of(start.held_by),
                start.q,
                targets,
                tools.planner.engines(scene),
                fraction_min=1.0,
                tip_limits=TipLimits(SLOW.speed_m_per_s, SLOW.acceleration_m_per_s2),
            )
            segment = Segment(stage, move.trajectory, start.openings, scene=scene, verification=move.verification)
    except PlanningError as error:
        return Failure(error.reason, f"{label}: {error.message}" if label else error.message)
    assert segment.trajectory is not None
    end = replace(start, q=segment.trajectory.q[-1], T_world_object=np.array(T_world_goal))
    return Candidate(label, cost, start, end, (segment,))
