"""Drivers of the mode demonstration.

moveit  plans to above the object, or home
teleop  a scripted leader puts the object down at a start pose
policy  the trained policy carries it to the goal
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from minidual.control.commands import JointCommand, Refusal, TrajectoryCommand
from minidual.control.object_path import minimum_jerk
from minidual.control.stack import DEFAULT_CONTROLLERS, ControlStack
from minidual.errors import ExitCode, MinidualError
from minidual.motion.api import Planner
from minidual.plant.world import World
from minidual.robot.pair import Array
from minidual.skills.operator import ScriptedOperator
from minidual.skills.phases import PHASES
from minidual.tasks.judge import Judge
from minidual.tasks.rod_carry import grasp_offsets, level_part, placement
from minidual.tasks.task import Task, Trial

if TYPE_CHECKING:
    from minidual.policies.kinds import Image
    from minidual.policies.policy import PolicyRuntime

_JOIN_SPEED_RAD_S = 0.7
_JOIN_MIN_S = 1.0
_QUIET_S = 0.5


class SwitchError(MinidualError):
    """A mode did not get the arms, or a command was refused."""

    exit_code = ExitCode.ACCEPTANCE_FAILED


class Driver:
    """One mode's turn."""

    controllers: tuple[str, ...] = DEFAULT_CONTROLLERS
    caption = ""

    def begin(self) -> None:
        """Called when the switch is confirmed."""

    def tick(self) -> None:
        """Propose a command before an arbiter tick."""

    def watch(self) -> None:
        """Called after each control step."""

    @property
    def done(self) -> bool:
        """Whether the turn is over."""
        return True

    def result(self) -> dict[str, object]:
        """Return its result."""
        return {}


class MoveitDriver(Driver):
    """Plans when its turn begins and proposes the trajectories.

    With `home` it drives home with the single-arm controllers, otherwise above the object. The turn ends after
    `share` of the motion.
    """

    def __init__(
        self, stack: ControlStack[World], planner: Planner, seed: int, *, home: bool, share: float = 1.0
    ) -> None:
        self.stack, self._planner, self._seed = stack, planner, seed
        self._home, self._share = home, share
        self.controllers = ("left_arm", "right_arm") if home else DEFAULT_CONTROLLERS
        self.caption = "planned: home, one arm after the other" if home else "planned: to above the object"
        self._groups = ["left_arm", "right_arm"] if home else ["both_arms"]
        self._sequence = 0
        self._began_s = self._planned_s = 0.0
        self._motion_s: list[float] = []
        self._refusals_before = 0

    def begin(self) -> None:
        """Plan the first trajectory."""
        self._refusals_before = len(self.stack.refusals)
        self._began_s = self.stack.plant.time
        self._next()

    def tick(self) -> None:
        """Send the heartbeat; propose the next trajectory."""
        self.stack.affirm("moveit")
        if self._groups and not self.stack.executing:
            self._next()

    def watch(self) -> None:
        """Raise SwitchError for a refused trajectory."""
        for refusal in self.stack.refusals[self._refusals_before :]:
            if refusal.source == "moveit":
                self._fail(refusal)

    @property
    def done(self) -> bool:
        """Whether its share is complete."""
        if self._groups:
            return False
        if self._share < 1.0:
            return self.stack.plant.time - self._began_s >= self._share * sum(self._motion_s)
        return not self.stack.executing

    def result(self) -> dict[str, object]:
        """Return planning times and distance from home."""
        return {
            "trajectories_s": self._motion_s,
            "planning_s": self._planned_s,
            "from_home_rad": float(np.abs(self.stack.plant.q - self.stack.plant.robot.home).max()),
        }

    def _next(self) -> None:
        world: World = self.stack.plant
        group = self._groups.pop(0)
        if self._home:
            # The other arm is held in place.
            result = self._planner.plan_to_joints(
                group, world.q, world.robot.home[world.robot.groups[group]], seed=self._seed
            )
        else:
            lies = level_part(world.object_pose())
            lies[2, 3] += PHASES["approach"].rise_m
            grasps = grasp_offsets(world.scene)
            targets = {arm: lies @ grasp for arm, grasp in zip(world.robot.sides, grasps, strict=True)}
            result = self._planner.plan_to_poses(group, world.q, targets, seed=self._seed)
        self._planned_s += result.total_s
        self._motion_s.append(result.trajectory.duration_s)
        self._sequence += 1
        command = TrajectoryCommand(result.trajectory, np.ones(2), world.time, self._sequence, group)
        refusal = self.stack.propose("moveit", command)
        if refusal is not None:
            self._fail(refusal)

    def _fail(self, refusal: Refusal) -> NoReturn:
        raise SwitchError(
            f"trajectory {self._sequence} of mode 'moveit' was refused at {self.stack.plant.time:.2f} s "
            f"({refusal.name}): {refusal.detail}"
        )


class TeleopDriver(Driver):
    """A scripted leader: puts the object at `target`'s start, then goes home."""

    caption = "scripted leader: fetches the object, puts it at a new start"

    def __init__(
        self, stack: ControlStack[World], operator: ScriptedOperator, target: Trial, seed: int, rate_hz: float
    ) -> None:
        self.stack, self._operator, self._target = stack, operator, target.start
        self._seed, self._rate = seed, rate_hz
        self._q, self._opening = np.empty((0, stack.plant.robot.dof)), np.empty((0, 2))
        self._k = 0

    def begin(self) -> None:
        """Plan the leader's motion."""
        world: World = self.stack.plant
        lies = level_part(world.object_pose())
        trial = Trial("modes", 0, {world.objects[0]: placement(lies)}, self._target)
        plan = self._operator.plan(trial, seed=self._seed, rate_hz=self._rate)
        over = next(p.end_s for p in plan.phases if p.name == "approach")
        first = round(over * self._rate)
        q = plan.q[first:]
        there, back = self._between(world.q, q[0]), self._between(q[-1], world.robot.home)
        q = np.vstack([there, q, back])
        gripper = np.ones((len(q), 2))
        gripper[len(there) : len(q) - len(back)] = plan.gripper[first:]
        self._q, self._opening = q, gripper

    def _between(self, a: Array, b: Array) -> Array:
        """Return rest-to-rest joint targets (k, n)."""
        span = max(_JOIN_MIN_S, 1.875 * float(np.abs(b - a).max()) / _JOIN_SPEED_RAD_S)
        n = round(span * self._rate)
        blend = np.array([minimum_jerk(k / n)[0] for k in range(n + 1)])
        return a + blend[:, None] * (b - a)

    def tick(self) -> None:
        """Propose a posture."""
        k = min(self._k, len(self._q) - 1)
        self._k += 1
        command = JointCommand(self._q[k], self._opening[k], self.stack.plant.time, self._k)
        self.stack.propose("teleop", command)

    @property
    def done(self) -> bool:
        """Whether the leader is home."""
        return self._k >= len(self._q) + round(0.2 * self._rate)

    def result(self) -> dict[str, object]:
        """Return the goal error."""
        lies = level_part(self.stack.plant.object_pose())
        x, y, _ = placement(next(iter(self._target.values())))
        error = float(np.hypot(lies[0, 3] - x, lies[1, 3] - y))
        return {"goal_error_m": error}


class PolicyDriver(Driver):
    """The policy drives from images and joints.

    A flush of the stack drops its chunk. `picture` returns the (H, W, 3) image of a camera.
    """

    caption = "ACT policy: carries the object to the goal"

    def __init__(
        self,
        stack: ControlStack[World],
        runtime: PolicyRuntime,
        picture: Callable[[str], Image],
        task: Task,
        trial: Trial,
    ) -> None:
        self.stack, self._runtime, self._picture = stack, runtime, picture
        self._judge = Judge(task, trial)
        self._sequence = 0
        self._began_s = self._finished_s = 0.0
        stack.on_flush(lambda mode: runtime.reset())

    def begin(self) -> None:
        """Start an episode."""
        self._runtime.reset()
        self._began_s = self.stack.plant.time

    def tick(self) -> None:
        """Propose an action."""
        world: World = self.stack.plant
        state = np.concatenate([world.q, world.gripper])
        images = {name: partial(self._picture, name) for name in self._runtime.cameras}
        action, n = self._runtime.act(images, state), self._runtime.joints_n
        self._sequence += 1
        command = JointCommand(action[:n], np.clip(action[n:], 0.0, 1.0), world.time, self._sequence)
        self.stack.propose("policy", command)

    def watch(self) -> None:
        """Judge the present state."""
        world: World = self.stack.plant
        self._judge.observe(world)
        if not self._judge.finished:
            self._finished_s = world.time

    @property
    def done(self) -> bool:
        """Whether the trial is finished for 0.5 s or timed out."""
        world: World = self.stack.plant
        over = world.time - self._began_s >= world.scene.task.time_limit_s
        return over or (self._judge.finished and world.time - self._finished_s >= _QUIET_S)

    def result(self) -> dict[str, object]:
        """Return `put_down_at_goal` and goal error."""
        error = self._judge.outcome(self.stack.plant).goal_error_m
        return {
            "put_down_at_goal": bool(self._judge.finished),
            "goal_error_m": error,
            "inference_hz": self._runtime.inference_hz,
        }
