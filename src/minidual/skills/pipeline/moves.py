"""Stages of the hands: move there, come straight, close, open, go straight away."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from minidual.collision.errors import LinearMoveError, PlanningError
from minidual.collision.scene import PlanningScene
from minidual.motion.goals import check_joints
from minidual.motion.linear import LinearMove
from minidual.robot.constants import ARMS, GROUPS, Array
from minidual.robot.trajectory import Trajectory
from minidual.skills.pipeline.stage import (
    Backward,
    Candidate,
    Connector,
    Failure,
    Forward,
    Generator,
    Offer,
    Tools,
    failure,
    group_of,
)
from minidual.skills.pipeline.state import CLOSED, OPEN, Segment, State, raised


class MoveTo(Connector):
    """Any free way between two states; what is held comes along."""

    def __init__(self, name: str = "move_to", budget_s: float = 5.0) -> None:
        super().__init__(name)
        self._budget_s = budget_s

    def offers(self, start: State, end: State, tools: Tools) -> Iterator[Offer]:
        """Yield the planner's path."""
        moving = tuple(arm for arm in ARMS if np.any(end.q[GROUPS[f"{arm}_arm"]] != start.q[GROUPS[f"{arm}_arm"]]))
        if moving and len(start.held_by) == len(ARMS):
            yield Failure("closed_chain", "both hands hold the object; a free motion would tear it from them")
            return
        group = group_of(moving or ARMS)
        scene = tools.scene(start)
        try:
            plan = tools.planner.plan_to_joints(
                group, start.q, end.q, scene=scene, seed=tools.seed, budget_s=self._budget_s
            )
        except PlanningError as error:
            yield failure(error)
            return
        segment = Segment(self.name, plan.trajectory, end.openings, scene=scene, verification=plan.verification)
        yield Candidate("straight" if plan.direct else f"{len(plan.path)} vertices", 0.0, start, end, (segment,))


class GoTo(Generator):
    """A fixed configuration of some arms; the others and the object stay as they are.

    Args:
        name: Of the stage.
        q: All 14 joints [rad]; those of other arms are not looked at.
        arms: That go there.
    """

    def __init__(self, name: str, q: Array, arms: tuple[str, ...] = ARMS) -> None:
        super().__init__(name)
        self._q, self._arms = check_joints(q, f"configuration of stage '{name}'"), arms

    def offers(self, first: State, tools: Tools) -> Iterator[Offer]:
        """Yield the configuration."""
        q = first.q.copy()
        for arm in self._arms:
            q[GROUPS[f"{arm}_arm"]] = self._q[GROUPS[f"{arm}_arm"]]
        state = replace(first, q=q)
        yield Candidate("as given", 0.0, state, state)


@dataclass(frozen=True, eq=False)
class Grip:
    """One way to hold the object.

    Attributes:
        label: For people.
        grasps: {arm: T_object_tcp (4, 4)}.
        cost: Preference.
    """

    label: str
    grasps: Mapping[str, Array]
    cost: float = 0.0


class Grasp(Generator):
    """Postures in which the hands are at the object: every grip, several solutions of each."""

    def __init__(self, name: str, grips: Sequence[Grip], solutions_n: int = 2) -> None:
        super().__init__(name)
        self.grips = tuple(sorted(grips, key=lambda grip: grip.cost))
        self._solutions_n = solutions_n

    def offers(self, first: State, tools: Tools) -> Iterator[Offer]:
        """Yield postures with open hands round the object."""
        for index, grip in enumerate(self.grips):
            arms = tuple(grip.grasps)
            scene = tools.scene(first, touching=arms)
            targets = {arm: first.T_world_object @ T for arm, T in grip.grasps.items()}
            config = tools.planner.config
            try:
                found = tools.poses.candidates(
                    group_of(arms),
                    first.q,
                    targets,
                    tools.planner.engines(scene).mujoco,
                    tools.rng(1, index),
                    restarts_n=config.ik_restarts_n,
                    candidates_n=self._solutions_n,
                )
            except PlanningError as error:
                yield Failure(error.reason, f"{grip.label}: {error.message}")
                continue
            for rank, q in enumerate(found):
                state = replace(first, q=q, T_world_place=None).opened(arms, OPEN)
                label = grip.label if rank == 0 else f"{grip.label}, posture {rank + 1}"
                yield Candidate(label, grip.cost + 0.5 * rank, state, state)


class Approach(Backward):
    """Straight down onto the object, planned backwards from the grasp."""

    def __init__(self, name: str, arms: tuple[str, ...], heights_m: Sequence[float] = (0.08, 0.12, 0.05)) -> None:
        super().__init__(name)
        self._arms, self._heights = arms, tuple(heights_m)

    def offers(self, end: State, tools: Tools) -> Iterator[Offer]:
        """Yield straight ways to `end` from above."""
        scene = tools.scene(end, touching=self._arms)
        for rank, height in enumerate(self._heights):
            try:
                away = straight_up(tools, end, self._arms, height, scene)
                there = reversed_in_time(away.trajectory)
            except PlanningError as error:
                yield Failure(error.reason, f"from {height * 100:.0f} cm: {error.message}")
                continue
            proof = tools.planner.engines(scene).verifier.verify(there)
            if not proof.ok:
                yield Failure("proof", f"from {height * 100:.0f} cm: {proof.reason}")
                continue
            start = replace(end, q=there.q[0])
            segment = Segment(self.name, there, end.openings, scene=scene, verification=proof)
            yield Candidate(f"from {height * 100:.0f} cm", 0.2 * rank, start, end, (segment,))


class Close(Forward):
    """Close the hands: from here on they hold the object by the grasps that they are at."""

    def __init__(self, name: str, arms: tuple[str, ...], hold_s: float = 0.75) -> None:
        super().__init__(name)
        self._arms, self._hold_s = arms, hold_s

    def offers(self, start: State, tools: Tools) -> Iterator[Offer]:
        """Yield the one way to close."""
        tips = dict(zip(ARMS, tools.kinematics.tcp_poses(start.q), strict=True))
        T_object_world = np.linalg.inv(start.T_world_object)
        held = {**start.held_by, **{arm: T_object_world @ tips[arm] for arm in self._arms}}
        end = replace(start.opened(self._arms, CLOSED), held_by=held)
        yield Candidate("", 0.0, start, end, (Segment(self.name, None, end.openings, hold_s=self._hold_s),))


class Release(Forward):
    """Open hands: the object stays where it is, or with the other hand."""

    def __init__(self, name: str, arms: tuple[str, ...], settle_s: float = 0.2, open_s: float = 0.55) -> None:
        super().__init__(name)
        self._arms, self._settle_s, self._open_s = arms, settle_s, open_s

    def offers(self, start: State, tools: Tools) -> Iterator[Offer]:
        """Yield the one way to open."""
        missing = [arm for arm in self._arms if arm not in start.held_by]
        if missing:
            yield Failure("not_held", f"the {missing[0]} hand holds nothing to release")
            return
        held = {arm: T for arm, T in start.held_by.items() if arm not in self._arms}
        end = replace(start.opened(self._arms, OPEN), held_by=held)
        segments = (
            Segment(self.name, None, start.openings, hold_s=self._settle_s),
            Segment(self.name, None, end.openings, hold_s=self._open_s),
        )
        yield Candidate("", 0.0, start, end, segments)


class Retreat(Forward):
    """Straight up, away from the object that was let go."""

    def __init__(self, name: str, arms: tuple[str, ...], heights_m: Sequence[float] = (0.10, 0.06)) -> None:
        super().__init__(name)
        self._arms, self._heights = arms, tuple(heights_m)

    def offers(self, start: State, tools: Tools) -> Iterator[Offer]:
        """Yield straight ways up from `start`."""
        scene = tools.scene(start, touching=self._arms)
        for rank, height in enumerate(self._heights):
            try:
                move = straight_up(tools, start, self._arms, height, scene)
            except PlanningError as error:
                yield Failure(error.reason, f"by {height * 100:.0f} cm: {error.message}")
                continue
            end = replace(start, q=move.trajectory.q[-1])
            segment = Segment(self.name, move.trajectory, start.openings, scene=scene, verification=move.verification)
            yield Candidate(f"by {height * 100:.0f} cm", 0.2 * rank, start, end, (segment,))


def straight_up(tools: Tools, state: State, arms: tuple[str, ...], height_m: float, scene: PlanningScene) -> LinearMove:
    """Return the whole straight move of the hands by a height [m], proven.

    Raises:
        LinearMoveError: It does not go all the way.
    """
    tips = dict(zip(ARMS, tools.kinematics.tcp_poses(state.q), strict=True))
    targets = {arm: raised(tips[arm], height_m) for arm in arms}
    return tools.linear.plan(group_of(arms), state.q, targets, tools.planner.engines(scene), fraction_min=1.0)


def reversed_in_time(trajectory: Trajectory | None) -> Trajectory:
    """Return the trajectory driven backwards: same way, same accelerations, speeds turned round."""
    if trajectory is None:
        raise LinearMoveError("there is no motion to reverse")
    return Trajectory(
        trajectory.times, trajectory.q[::-1].copy(), -trajectory.v[::-1], trajectory.a[::-1].copy(), trajectory.group
    )
