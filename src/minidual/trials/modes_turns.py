"""Turns of the mode demonstration: planned motion, a scripted leader, the trained policy."""

from collections.abc import Callable, Generator
from typing import NamedTuple

import numpy as np

from minidual.control.commands import JointCommand, TrajectoryCommand
from minidual.control.kernels import minimum_jerk
from minidual.control.stack import DEFAULT_CONTROLLERS, ControlStack
from minidual.errors import ExitCode, MinidualError
from minidual.motion.api import Planner, PlanResult
from minidual.plant.world import World
from minidual.policies.pilot import Picture, next_command
from minidual.policies.policy import PolicyRuntime
from minidual.robot.pair import Array
from minidual.skills.operator import ScriptedOperator
from minidual.skills.phases import PHASES
from minidual.tasks.judge import begin
from minidual.tasks.task import Task, Trial, grasp_offsets, level_part, placement

_JOIN_SPEED_RAD_S = 0.7
_JOIN_MIN_S = 1.0
_MINIMUM_JERK_PEAK = 1.875  # peak over mean speed of a minimum-jerk motion
_LEADER_REST_S = 0.2
_QUIET_S = 0.5

type Steps = Generator[None, None, dict[str, object]]
"""Proposes commands; each `yield` is one control step. Returns the turn's result."""


class SwitchError(MinidualError):
    """A mode did not get the arms, or a command was refused."""

    exit_code = ExitCode.ACCEPTANCE_FAILED


class Turn(NamedTuple):
    """One mode's turn; `drive` is called when the switch is confirmed."""

    mode: str
    caption: str
    drive: Callable[[], Steps]
    controllers: tuple[str, ...] = DEFAULT_CONTROLLERS


def moveit(
    stack: ControlStack[World],
    planner: Planner,
    seed: int,
    *,
    home: bool,
    share: float = 1.0,
) -> Turn:
    """Plan to above the object and drive `share` of the motion; or home, one arm after the other.

    Raises:
        SwitchError: While it drives: a trajectory was refused.
    """
    world = stack.plant
    robot = world.robot
    groups = ("left_arm", "right_arm") if home else ("both_arms",)

    def plan(group: str) -> PlanResult:
        if home:  # the other arm is held in place
            q_goal = robot.home[robot.groups[group]]
            return planner.plan_to_joints(group, world.q, q_goal, seed=seed)
        targets = _above_the_object(world)
        return planner.plan_to_poses(group, world.q, targets, seed=seed)

    def drive() -> Steps:
        refused_before = stack.refused_n
        planned_s = 0.0
        motions_s = list[float]()
        for number, group in enumerate(groups, start=1):
            result = plan(group)
            planned_s += result.total_s
            motions_s.append(result.trajectory.duration_s)
            end_s = world.time + share * motions_s[-1]
            command = TrajectoryCommand(result.trajectory, np.ones(2), world.time, number, group)
            refusal = stack.propose("moveit", command)
            while refusal is None and stack.executing and (share == 1.0 or world.time < end_s):
                if stack.tick_next:
                    stack.affirm("moveit")
                yield
                for recent in stack.refused_since(refused_before):
                    if recent.source == "moveit":
                        refusal = recent
                        break
            if refusal is not None:
                title = f"trajectory {number} of mode 'moveit' was refused at {world.time:.2f} s"
                raise SwitchError(f"{title} ({refusal.name}): {refusal.detail}")
        return {
            "trajectories_s": motions_s,
            "planning_s": planned_s,
            "from_home_rad": float(np.abs(world.q - robot.home).max()),
        }

    if home:
        return Turn("moveit", "planned: home, one arm after the other", drive, groups)
    return Turn("moveit", "planned: to above the object", drive)


def _above_the_object(world: World) -> dict[str, Array]:
    """Return T_world_tcp (4, 4) of each hand over its grasp."""
    T_world_above = level_part(world.object_pose())
    T_world_above[2, 3] += PHASES["approach"].rise_m
    offsets = zip(world.robot.sides, grasp_offsets(world.scene), strict=True)
    return {arm: T_world_above @ T_object_tcp for arm, T_object_tcp in offsets}


class _LeaderMotion(NamedTuple):
    """What the scripted leader proposes at each tick: q (k, n) [rad] and opening (k, 2)."""

    q: Array
    opening: Array


def teleop(
    stack: ControlStack[World],
    operator: ScriptedOperator,
    target: Trial,
    seed: int,
    rate_hz: float,
) -> Turn:
    """Let a scripted leader put the object down at `target`'s start, then go home."""
    world = stack.plant

    def motion() -> _LeaderMotion:
        start = placement(level_part(world.object_pose()))
        trial = Trial("modes", 0, {world.objects[0]: start}, target.start)
        plan = operator.plan(trial, seed=seed, rate_hz=rate_hz)
        first = round(operator.phases()["approach"][1] * rate_hz)
        there = _rest_to_rest(world.q, plan.q[first], rate_hz)
        back = _rest_to_rest(plan.q[-1], world.robot.home, rate_hz)
        rest = np.tile(back[-1], (round(_LEADER_REST_S * rate_hz), 1))
        q = np.vstack([there, plan.q[first:], back, rest])
        opening = np.ones((len(q), 2))
        planned = slice(len(there), len(there) + len(plan.q) - first)
        opening[planned] = plan.gripper[first:]
        return _LeaderMotion(q, opening)

    def drive() -> Steps:
        q, opening = motion()
        for k in range(len(q)):
            while not stack.tick_next:
                yield
            stack.propose("teleop", JointCommand(q[k], opening[k], world.time, k + 1))
            yield
        x, y, _ = placement(next(iter(target.start.values())))
        error = level_part(world.object_pose())[:2, 3] - (x, y)
        return {"goal_error_m": float(np.hypot(*error))}

    return Turn("teleop", "scripted leader: fetches the object, puts it at a new start", drive)


def _rest_to_rest(q_start: Array, q_end: Array, rate_hz: float) -> Array:
    """Return joint targets (k, n) of a minimum-jerk motion."""
    turn_rad = float(np.abs(q_end - q_start).max())
    duration_s = max(_JOIN_MIN_S, _MINIMUM_JERK_PEAK * turn_rad / _JOIN_SPEED_RAD_S)
    count = round(rate_hz * duration_s)
    blend = np.array([minimum_jerk(k / count)[0] for k in range(count + 1)])
    return q_start + blend[:, None] * (q_end - q_start)


def policy(
    stack: ControlStack[World],
    runtime: PolicyRuntime,
    picture: Picture,
    task: Task,
    trial: Trial,
) -> Turn:
    """Let the policy drive until the trial has been finished for 0.5 s, or its time is over.

    `picture` as in `next_command`.
    """
    world = stack.plant
    stack.on_flush(lambda mode: runtime.reset())

    def drive() -> Steps:
        runtime.reset()
        judge = begin(world, task, trial, reset=False)
        began_s = world.time
        unfinished_s = world.time
        sequence = 0
        while world.time - began_s < task.time_limit_s and world.time - unfinished_s < _QUIET_S:
            if stack.tick_next:
                sequence += 1
                stack.propose("policy", next_command(runtime, world, picture, sequence))
            yield
            judge.observe(world)
            if not judge.finished:
                unfinished_s = world.time
        return {
            "put_down_at_goal": judge.finished,
            "goal_error_m": judge.outcome(world).number("goal_error_m"),
            "inference_hz": runtime.inference_hz,
        }

    return Turn("policy", "trained policy: carries the object to the goal", drive)
