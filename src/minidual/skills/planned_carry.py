"""Carry the rod by planning alone: OMPL to the rod, a closed-chain plan with it, joint trajectory control throughout.

The whole cycle is planned before the arms move, from the rod's pose: approach (OMPL, proven free), straight
descent, the carry on which both hands keep their grasps, straight retreat. Each trajectory is proposed to the arbiter
when the one before it has ended. Nothing is fed back but joint positions; the squeeze is whatever the stiff joints
happen to give.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.config.arbiter import ArbiterConfig
from minidual.config.planning import PlannerConfig
from minidual.control.commands import ArbiterState, TrajectoryCommand
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.motion.api import Planner
from minidual.motion.closed_chain import CarriedPlanner, ObjectLimits
from minidual.plant.world import World
from minidual.robot.constants import ARMS, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.trajectory import Trajectory
from minidual.skills.supervised import arm_distance
from minidual.tasks.rod_carry import RodTrial, grasp_offsets, level_part, level_pose

SOURCE = "moveit"

_HOVER_M = 0.08
_RETREAT_M = 0.10
_CLOSE_S, _OPEN_S, _SETTLE_S = 0.75, 0.55, 0.2
_GAP_MARGIN_M, _GAP_STEP_S = 0.005, 0.005
_ATTEMPTS, _NEXT_SEED = 5, 1_000_003
_CARRY_LIMITS = ObjectLimits(speed_m_per_s=0.35, acceleration_m_per_s2=1.0)
_STRAIGHT_LIMITS = ObjectLimits(speed_m_per_s=0.15, acceleration_m_per_s2=0.6)


class PlannedCarry:
    """One planned trial; call `step` until `done`.

    Args:
        world: The plant, already reset.
        kinematics: Dynamics for the joint controller.
        planner: Plans to the rod; shared by trials.
        carrier: Plans with the rod in both hands; shared by trials.
        trial: Goal.
        seed: Of the planner.
        arbiter: Bounds of the arbiter.
        T_world_object: Pose (4, 4) at which the object is believed to lie, as it was sensed before the motion; where it
            truly lies by default.
        supervisor: Guards the motors; its reflex ends the trial. The plan keeps the distance between the arms that it
            watches, with a margin.
    """

    def __init__(
        self,
        world: World,
        kinematics: Kinematics,
        planner: Planner,
        carrier: CarriedPlanner,
        trial: RodTrial,
        seed: int,
        arbiter: ArbiterConfig | None = None,
        *,
        T_world_object: Array | None = None,
        supervisor: Supervisor | None = None,
    ) -> None:
        self.world = world
        self.aborted: str | None = None
        self.T_world_object = world.object_pose() if T_world_object is None else T_world_object
        self.stack = ControlStack(world, kinematics, arbiter, supervisor=supervisor)
        self._segments: list[tuple[str, Trajectory, float]] = []
        self._proposed = 0
        try:
            self._segments = self._plan_apart(planner, carrier, trial, seed, supervisor)
        except PlanningError as error:
            self.aborted = error.message
        else:
            self.stack.request(SOURCE)

    def _plan_apart(
        self, planner: Planner, carrier: CarriedPlanner, trial: RodTrial, seed: int, supervisor: Supervisor | None
    ) -> list[tuple[str, Trajectory, float]]:
        """Return a cycle on which the arms keep the supervisor's distance.

        A plan is proven free of collisions, and may bring the elbows closer to each other than the supervisor lets
        them come: then another posture over the rod is looked for, and a seed under which none is found is passed over.
        A planner that finds nothing at once has failed: that is not tried again.
        """
        if supervisor is None:
            return self._plan(planner, carrier, trial, seed)
        bound = supervisor.config.self_collision_min_m + _GAP_MARGIN_M
        nearest: list[tuple[float, str]] = []
        for attempt in range(_ATTEMPTS):
            try:
                segments = self._plan(planner, carrier, trial, seed + attempt * _NEXT_SEED)
            except PlanningError:
                if attempt == 0:
                    raise
                continue
            nearest.append(_nearest(segments))
            if nearest[-1][0] >= bound:
                return segments
        gap, pair = max(nearest)
        raise PlanningError(
            f"no plan in {_ATTEMPTS} keeps {1e3 * bound:.0f} mm between the arms: {pair} at {1e3 * gap:.1f} mm at best",
            remedy="lower supervisor.self_collision_min_m, or place the rod elsewhere",
        )

    def _plan(
        self, planner: Planner, carrier: CarriedPlanner, trial: RodTrial, seed: int
    ) -> list[tuple[str, Trajectory, float]]:
        """Return (phase, trajectory, gripper opening) of the whole cycle."""
        scene = self.world.scene
        grasps = grasp_offsets(scene)
        start = level_part(self.T_world_object)
        goal = level_pose(trial.goal[0], trial.goal[1], scene.rod.rest_height_m, trial.goal[2])
        lift = scene.task.lift_height_m
        targets = {arm: _raised(start, _HOVER_M) @ grasp for arm, grasp in zip(ARMS, grasps, strict=True)}
        approach = planner.plan_to_poses("both_arms", self.world.q, targets, seed=seed).trajectory

        def straight(after: Trajectory, poses: Sequence[Array], limits: ObjectLimits) -> Trajectory:
            return carrier.plan(after.q[-1], poses, *grasps, object_limits=limits)

        descent = straight(approach, [_raised(start, _HOVER_M), start], _STRAIGHT_LIMITS)
        carry = straight(descent, [start, _raised(start, lift), _raised(goal, lift), goal], _CARRY_LIMITS)
        retreat = straight(carry, [goal, _raised(goal, _RETREAT_M)], _STRAIGHT_LIMITS)
        return [
            ("approach", approach, 1.0),
            ("descend", descent, 1.0),
            ("close", _stay(descent, _CLOSE_S), 0.0),
            ("carry", carry, 0.0),
            ("settle", _stay(carry, _SETTLE_S), 0.0),
            ("open", _stay(carry, _OPEN_S), 1.0),
            ("retreat", retreat, 1.0),
        ]

    @property
    def phase(self) -> str:
        """Name of the phase the trial is in."""
        return self._segments[0][0] if self._segments else "done"

    @property
    def done(self) -> bool:
        """Return whether the cycle is over, or was never planned."""
        return not self._segments

    def step(self) -> None:
        """Run one control and physics step."""
        stack = self.stack
        if self._segments and not stack.executing and stack.source == SOURCE:
            self._propose_next()
        if self._segments:
            stack.affirm(SOURCE)
        try:
            stack.step()
        except ReflexError as error:
            self.aborted = f"phase '{self.phase}': {error.message}"
            self._segments = []
        if self._segments and stack.state == ArbiterState.STOPPED:
            self._abort("the arms were not handed over")

    def _propose_next(self) -> None:
        """Propose the next trajectory; the one before it, if any, has ended."""
        refused = next((r for r in self.stack.refusals if r.source == SOURCE), None)
        if refused is None:
            if self._proposed > 0:
                self._segments.pop(0)
            if not self._segments:
                return
            _, motion, opening = self._segments[0]
            self._proposed += 1
            command = TrajectoryCommand(motion, np.full(2, opening), self.world.time, self._proposed)
            refused = self.stack.propose(SOURCE, command)
        if refused is not None:
            self._abort(f"{refused.name}: {refused.detail}")

    def _abort(self, reason: str) -> None:
        self.aborted = f"the arbiter stopped phase '{self.phase}' ({reason})"
        self._segments = []


def _nearest(segments: Sequence[tuple[str, Trajectory, float]]) -> tuple[float, str]:
    """Return the least distance between the arms [m] on a cycle, and between what."""
    distance = arm_distance()
    found: list[tuple[float, str]] = []
    for _, motion, _ in segments:
        for q in motion.sample_many(np.arange(0.0, motion.duration_s + _GAP_STEP_S, _GAP_STEP_S))[0]:
            pair, gap = distance(q)
            found.append((gap, pair))
    return min(found)


def _stay(after: Trajectory, duration_s: float) -> Trajectory:
    """Return the trajectory that rests for a while where another one ends."""
    q = np.array([after.q[-1], after.q[-1]])
    still = np.zeros_like(q)
    return Trajectory(np.array([0.0, duration_s]), q, still, still.copy(), after.group)


def _raised(T: Array, height_m: float) -> Array:
    """Return the pose moved up by a height [m]."""
    T = T.copy()
    T[2, 3] += height_m
    return T


def make_planners(config: PlannerConfig) -> tuple[Planner, CarriedPlanner]:
    """Return the planners that trials of one process share."""
    return Planner(config=config), CarriedPlanner()
