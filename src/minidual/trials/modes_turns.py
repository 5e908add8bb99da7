"""Turns of the mode demonstration: planned motion, a scripted leader, the trained policy."""

import itertools
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np

from minidual.config.scene import SceneConfig
from minidual.control.commands import JointCommand, TrajectoryCommand
from minidual.control.kernels import minimum_jerk
from minidual.control.stack import DEFAULT_CONTROLLERS, ControlStack
from minidual.demos.sensed import SensedInputs
from minidual.errors import ExitCode, MinidualError
from minidual.motion.api import Planner, PlanResult
from minidual.plant.lifecycle import runs_on
from minidual.plant.protocol import Plant
from minidual.policies.pilot import Picture, next_command
from minidual.policies.policy import PolicyRuntime
from minidual.robot.pair import Array, Robot
from minidual.skills.operator import ScriptedOperator
from minidual.skills.phases import PHASES
from minidual.tasks.judge import begin_here
from minidual.tasks.task import Task, Trial, grasp_offsets, level_part, placement
from minidual.tasks.truth import GroundTruth

_JOIN_SPEED_RAD_S = 0.7
_JOIN_MIN_S = 1.0
_MINIMUM_JERK_PEAK = 1.875  # peak over mean speed of a minimum-jerk motion
_LEADER_REST_S = 0.2
_QUIET_S = 0.5

type Steps = Generator[None, None, dict[str, object]]
"""Proposes commands; each `yield` is one control step. Returns the turn's result."""


class KnownObject(NamedTuple):
    """Pose of the object, for planner and leader.

    Attributes:
        scene: In which it stands.
        T_world_object: Returns its present pose (4, 4).
    """

    scene: SceneConfig
    T_world_object: Callable[[], Array]


class SwitchError(MinidualError):
    """A mode did not get the arms, or a command was refused."""

    exit_code = ExitCode.ACCEPTANCE_FAILED


class Turn(NamedTuple):
    """One mode's turn; `drive` is called when the switch is confirmed."""

    mode: str
    caption: str
    drive: Callable[[], Steps]
    controllers: tuple[str, ...] = DEFAULT_CONTROLLERS


def while_held[T](
    stack: ControlStack[Plant],
    source: str,
    sequence: Iterator[int],
    work: Callable[[], T],
) -> Generator[None, None, T]:
    """Do long work while the arms are held.

    Where time runs on meanwhile, a thread does it, and the source that drives holds the arms.
    """
    if not runs_on(stack.plant):
        return work()
    q = np.array(stack.output.q_target)
    openings = np.array(stack.output.gripper)
    with ThreadPoolExecutor(1) as pool:
        result = pool.submit(work)
        while not result.done():
            if stack.tick_next:
                hold = JointCommand(q, openings, stack.plant.time, next(sequence))
                stack.propose(source, hold)
            yield
    return result.result()


def moveit(
    stack: ControlStack[Plant],
    planner: Planner,
    seed: int,
    known_object: KnownObject,
    *,
    home: bool,
    share: float = 1.0,
) -> Turn:
    """Plan to above the object and drive `share` of the motion; or home, one arm after the other.

    Raises:
        SwitchError: While it drives: a trajectory was refused.
    """
    plant = stack.plant
    robot = plant.robot
    groups = ("left_arm", "right_arm") if home else ("both_arms",)

    def plan(group: str) -> PlanResult:
        if home:  # the other arm is held in place
            q_goal = robot.home[robot.groups[group]]
            return planner.plan_to_joints(group, plant.q, q_goal, seed=seed)
        targets = _above_the_object(known_object, robot)
        return planner.plan_to_poses(group, plant.q, targets, seed=seed)

    def drive() -> Steps:
        refused_before = stack.refused_n
        planned_s = 0.0
        motions_s = list[float]()
        sequence = itertools.count(1)
        for number, group in enumerate(groups, start=1):
            result = yield from while_held(stack, "moveit", sequence, partial(plan, group))
            planned_s += result.total_s
            motions_s.append(result.trajectory.duration_s)
            end_s = plant.time + share * motions_s[-1]
            command = TrajectoryCommand(
                result.trajectory, np.ones(2), plant.time, next(sequence), group
            )
            refusal = stack.propose("moveit", command)
            while refusal is None and stack.executing and (share == 1.0 or plant.time < end_s):
                if stack.tick_next:
                    stack.affirm("moveit")
                yield
                for recent in stack.refused_since(refused_before):
                    if recent.source == "moveit":
                        refusal = recent
                        break
            if refusal is not None:
                title = f"trajectory {number} of mode 'moveit' was refused at {plant.time:.2f} s"
                raise SwitchError(f"{title} ({refusal.name}): {refusal.detail}")
        return {
            "trajectories_s": motions_s,
            "planning_s": planned_s,
            "from_home_rad": float(np.abs(plant.q - robot.home).max()),
        }

    if home:
        return Turn("moveit", "planned: home, one arm after the other", drive, groups)
    return Turn("moveit", "planned: to above the object", drive)


def _above_the_object(known_object: KnownObject, robot: Robot) -> dict[str, Array]:
    """Return T_world_tcp (4, 4) of each hand over its grasp."""
    T_world_above = level_part(known_object.T_world_object())
    T_world_above[2, 3] += PHASES["approach"].rise_m
    offsets = zip(robot.sides, grasp_offsets(known_object.scene), strict=True)
    return {arm: T_world_above @ T_object_tcp for arm, T_object_tcp in offsets}


class _LeaderMotion(NamedTuple):
    """Proposals of the scripted leader at each tick: q (k, n) [rad] and opening (k, 2)."""

    q: Array
    opening: Array


def teleop(
    stack: ControlStack[Plant],
    operator: ScriptedOperator,
    target: Trial,
    seed: int,
    rate_hz: float,
    known_object: KnownObject,
) -> Turn:
    """Let a scripted leader put the object down at `target`'s start, then go home."""
    plant = stack.plant

    def motion() -> _LeaderMotion:
        start = placement(level_part(known_object.T_world_object()))
        trial = Trial("modes", 0, {known_object.scene.object.name: start}, target.start)
        plan = operator.plan(trial, seed=seed, rate_hz=rate_hz)
        first = round(operator.phases()["approach"][1] * rate_hz)
        there = _rest_to_rest(plant.q, plan.q[first], rate_hz)
        back = _rest_to_rest(plan.q[-1], plant.robot.home, rate_hz)
        rest = np.tile(back[-1], (round(_LEADER_REST_S * rate_hz), 1))
        q = np.vstack([there, plan.q[first:], back, rest])
        opening = np.ones((len(q), 2))
        planned = slice(len(there), len(there) + len(plan.q) - first)
        opening[planned] = plan.gripper[first:]
        return _LeaderMotion(q, opening)

    def drive() -> Steps:
        sequence = itertools.count(1)
        q, opening = yield from while_held(stack, "teleop", sequence, motion)
        for k in range(len(q)):
            while not stack.tick_next:
                yield
            stack.propose("teleop", JointCommand(q[k], opening[k], plant.time, next(sequence)))
            yield
        x, y, _ = placement(next(iter(target.start.values())))
        error = level_part(known_object.T_world_object())[:2, 3] - (x, y)
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
    stack: ControlStack[Plant],
    runtime: PolicyRuntime,
    picture: Picture,
    task: Task,
    trial: Trial,
    truth: GroundTruth,
) -> Turn:
    """Let the policy drive until the trial has been finished for 0.5 s, or its time is over.

    `picture` as in `next_command`; the judge reads `truth`.
    """
    plant = stack.plant
    stack.on_flush(lambda mode: runtime.reset())
    sensed = SensedInputs(stack, runtime.inputs)

    def drive() -> Steps:
        runtime.reset()
        judge = begin_here(truth, task, trial)
        began_s = plant.time
        unfinished_s = plant.time
        sequence = 0
        while plant.time - began_s < task.time_limit_s and plant.time - unfinished_s < _QUIET_S:
            if stack.tick_next:
                sequence += 1
                stack.propose("policy", next_command(runtime, plant, picture, sensed, sequence))
            yield
            judge.observe(truth)
            if not judge.finished:
                unfinished_s = plant.time
        return {
            "put_down_at_goal": judge.finished,
            "goal_error_m": judge.outcome(truth).number("goal_error_m"),
            "inference_hz": runtime.inference_hz,
        }

    return Turn("policy", "trained policy: carries the object to the goal", drive)
