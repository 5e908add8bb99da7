"""Turns of the mode demonstration: planned motion, a scripted leader, the trained policy."""

from collections.abc import Callable, Generator
from typing import NamedTuple

import numpy as np

from minidual.control.commands import JointCommand, TrajectoryCommand
from minidual.control.kernels import minimum_jerk
from minidual.control.stack import DEFAULT_CONTROLLERS, ControlStack
from minidual.errors import ExitCode, MinidualError
from minidual.motion.api import Planner
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
    """Plan to above the object and drive `share` of the motion; or home, one arm after the other."""
    world = stack.plant
    robot = stack.plant.robot
    groups = ("left_arm", "right_arm") if home else ("both_arms",)

    def drive() -> Steps:
        before = stack.refused_n
        planned_s = 0.0
        motions_s = list[float]()
        for number, group in enumerate(groups, start=1):
            if home:  # the other arm is held in place
                result = planner.plan_to_joints(
                    group,
                    world.q,
                    robot.home[robot.groups[group]],
                    seed=seed,
                )
            else:
                above = level_part(world.object_pose())
                above[2, 3] += PHASES["approach"].rise_m
                targets = {
                    arm: above @ T
                    for arm, T in zip(robot.sides, grasp_offsets(world.scene), strict=True)
                }
                result = planner.plan_to_poses(group, world.q, targets, seed=seed)
            planned_s += result.total_s
            motions_s.append(result.trajectory.duration_s)
            end_s = world.time + share * motions_s[-1]
            command = TrajectoryCommand(result.trajectory, np.ones(2), world.time, number, group)
            refusal = stack.propose("moveit", command)
            while refusal is None and stack.executing and (share == 1.0 or world.time < end_s):
                if stack.tick_next:
                    stack.affirm("moveit")
                yield
                refusal = next(
                    (r for r in stack.refused_since(before) if r.source == "moveit"),
                    None,
                )
            if refusal is not None:
                which = f"trajectory {number} of mode 'moveit' was refused at {world.time:.2f} s"
                raise SwitchError(f"{which} ({refusal.name}): {refusal.detail}")
        from_home_rad = float(np.abs(world.q - robot.home).max())
        return {
            "trajectories_s": motions_s,
            "planning_s": planned_s,
            "from_home_rad": from_home_rad,
        }

    caption = "planned: home, one arm after the other" if home else "planned: to above the object"
    return Turn("moveit", caption, drive, groups if home else DEFAULT_CONTROLLERS)


def teleop(
    stack: ControlStack[World],
    operator: ScriptedOperator,
    target: Trial,
    seed: int,
    rate_hz: float,
) -> Turn:
    """Let a scripted leader put the object down at `target`'s start, then go home."""
    world = stack.plant

    def between(a: Array, b: Array) -> Array:
        """Return rest-to-rest joint targets (k, n)."""
        n = round(
            rate_hz * max(_JOIN_MIN_S, 1.875 * float(np.abs(b - a).max()) / _JOIN_SPEED_RAD_S),
        )
        blend = np.array([minimum_jerk(k / n)[0] for k in range(n + 1)])
        return a + blend[:, None] * (b - a)

    def drive() -> Steps:
        trial = Trial(
            "modes",
            0,
            {world.objects[0]: placement(level_part(world.object_pose()))},
            target.start,
        )
        plan = operator.plan(trial, seed=seed, rate_hz=rate_hz)
        first = round(operator.phases()["approach"][1] * rate_hz)
        there = between(world.q, plan.q[first])
        back = between(plan.q[-1], world.robot.home)
        q = np.vstack(
            [there, plan.q[first:], back, np.tile(back[-1], (round(_LEADER_REST_S * rate_hz), 1))],
        )
        opening = np.ones((len(q), 2))
        opening[len(there) : len(there) + len(plan.q) - first] = plan.gripper[first:]
        for k in range(len(q)):
            while not stack.tick_next:
                yield
            stack.propose("teleop", JointCommand(q[k], opening[k], world.time, k + 1))
            yield
        x, y, _ = placement(next(iter(target.start.values())))
        return {"goal_error_m": float(np.hypot(*(level_part(world.object_pose())[:2, 3] - (x, y))))}

    return Turn("teleop", "scripted leader: fetches the object, puts it at a new start", drive)


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
        began_s = finished_s = world.time
        sequence = 0
        while world.time - began_s < task.time_limit_s and world.time - finished_s < _QUIET_S:
            if stack.tick_next:
                sequence += 1
                stack.propose("policy", next_command(runtime, world, picture, sequence))
            yield
            judge.observe(world)
            finished_s = finished_s if judge.finished else world.time
        error_m = judge.outcome(world).number("goal_error_m")
        return {
            "put_down_at_goal": judge.finished,
            "goal_error_m": error_m,
            "inference_hz": runtime.inference_hz,
        }

    return Turn("policy", "ACT policy: carries the object to the goal", drive)
