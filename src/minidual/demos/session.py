"""One teleoperated episode; ticks follow simulated time."""

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from minidual.config.learning import MirrorConfig, TeleopConfig
from minidual.control.commands import HOLD, ArbiterState, JointCommand, Refusal
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.demos.leader import Leader
from minidual.errors import MinidualError, UsageError
from minidual.plant.render import Image
from minidual.plant.world import World
from minidual.robot.pair import Array, Robot
from minidual.tasks.judge import Judge, Outcome, begin
from minidual.tasks.task import Task, Trial

SOURCE = "teleop"
_BEYOND_RAD = 0.3
"""A leader further beyond a limit is no person's arm: degrees, a turn too many, infinity. The arbiter refuses it."""


class HandoverError(MinidualError):
    """The arbiter did not accept the leader."""


def check_start(robot: Robot, config: MirrorConfig, q_leader: Array, q_follower: Array) -> None:
    """Raise UsageError if a joint of leader and follower differs by more than the limit."""
    difference = follower_target(robot, q_leader) - q_follower
    worst = int(np.argmax(np.abs(difference)))
    limit = config.start_error_max_rad
    if abs(difference[worst]) > limit:
        far = f"the leader starts {difference[worst]:+.3f} rad away from the follower at {robot.joint_names[worst]}"
        many = f"{int(np.sum(np.abs(difference) > limit))} of {robot.dof} joints over the limit of {limit} rad"
        remedy = "bring the leader to the follower's posture; check the joint order, the signs and the offsets"
        raise UsageError(f"{far} ({many})", remedy=remedy)


def follower_target(robot: Robot, q_leader: Array) -> Array:
    """Return the leader's joints clipped to the follower's limits (n,) [rad]; UsageError for another shape.

    All zeros (lost values), NaN and values far beyond a limit pass unchanged, so that the arbiter refuses them.
    """
    q = np.asarray(q_leader, dtype=float)
    if q.shape != (robot.dof,):
        raise UsageError(
            f"the leader gives joints of shape {q.shape}; it must be ({robot.dof},), left then right",
        )
    clipped = np.clip(q, robot.q_lower, robot.q_upper)
    return clipped if q.any() and np.abs(clipped - q).max() < _BEYOND_RAD else q


class Tick(NamedTuple):
    """What was measured at one tick, and the command that followed; names and shapes as in the schema."""

    timestamps: float
    image_timestamps: float
    qpos: Array
    qvel: Array
    gripper: Array
    images: dict[str, Image]
    action: Array
    action_gripper: Array


@dataclass
class SessionResult:
    """One episode.

    Attributes:
        q: (T, n) measured joints [rad]; images go to `on_tick` only.
        latencies_s: Wall time per tick from reading the leader to the end of the first physics step.
        ended_by: "leader", "time_limit", "stopped" (no readings) or "reflex".
    """

    q: Array
    outcome: Outcome
    latencies_s: list[float]
    refusals: list[Refusal] = field(default_factory=list)
    ended_by: str = "leader"
    reflex: str = ""

    @property
    def success(self) -> bool:
        """Whether the task was achieved and the leader ended the episode."""
        return self.outcome.success and self.ended_by == "leader"

    @property
    def reason(self) -> str:
        """Why the episode is no demonstration, or ""."""
        if self.reflex:
            return self.reflex
        if self.ended_by == "stopped":
            return "the leader fell silent"
        if self.refusals:
            return f"the arbiter refused {self.refusals[0].name}: {self.refusals[0].detail}"
        return (
            ""
            if self.success
            else self.outcome.reason or "the leader did not end the episode in time"
        )


class TeleopSession:
    """Runs episodes in the stack's world, at its rate; a reflex ends the episode. `pictures` by camera, as recorded."""

    def __init__(
        self,
        stack: ControlStack[World],
        config: TeleopConfig,
        pictures: Callable[[], dict[str, Image]] = dict,
    ) -> None:
        self.stack = stack
        self.world = stack.plant
        self.config = config
        self._pictures = pictures

    def run(
        self,
        task: Task,
        trial: Trial,
        leader: Leader,
        *,
        on_tick: Callable[[Tick], None] = lambda tick: None,
    ) -> SessionResult:
        """Run one episode; `on_tick` is called after each command.

        Raises:
            UsageError: Leader and follower are apart, or have other joints.
            HandoverError: The arbiter refused.
            Exception: What failed in a leader, a camera or `on_tick`, once the arms have stopped.
        """
        try:
            return self._run(task, trial, leader, on_tick)
        except Exception as error:
            with contextlib.suppress(ReflexError):
                self.stack.fail(error)
                self.stack.advance()
            while self.stack.stopping:
                self.stack.advance()
            raise

    def _run(
        self,
        task: Task,
        trial: Trial,
        leader: Leader,
        on_tick: Callable[[Tick], None],
    ) -> SessionResult:
        world = self.world
        stack = self.stack
        period_s = 1.0 / self.config.rate_hz
        judge = begin(world, task, trial)
        stack.reset()
        if (first := leader.read(0.0)) is not None:
            check_start(world.robot, self.config.mirror, first[0], world.q)
        self._hand_over(judge)
        # The judge applies the task's own limit to people too.
        limit_s = (
            self.config.person_time_limit_s if leader.realtime else world.scene.task.time_limit_s
        )
        measured = list[Array]()
        latencies = list[float]()
        ended_by = "time_limit"
        began = time.monotonic()
        for k in range(round(limit_s * self.config.rate_hz)):
            elapsed_s = k * period_s
            if leader.finished(elapsed_s):
                ended_by = "leader"
                break
            if leader.realtime:
                time.sleep(max(0.0, began + elapsed_s - time.monotonic()))
            joints = (world.stamp_s, world.time, world.q, world.v, world.gripper)
            images = self._pictures()
            before = time.perf_counter()
            if (reading := leader.read(elapsed_s)) is not None:
                stack.propose(
                    SOURCE,
                    JointCommand(
                        follower_target(world.robot, reading[0]),
                        reading[1],
                        joints[0],
                        k,
                    ),
                )
            out = stack.arbitrate()
            tick = Tick(*joints, images, out.q_target, out.gripper)
            self._move(judge, 1)
            latencies.append(time.perf_counter() - before)
            measured.append(tick.qpos)
            on_tick(tick)
            if out.state == ArbiterState.STOPPED:
                ended_by = "stopped"
                break
            self._move(judge, stack.every - 1)
            if stack.reflex is not None:
                break
        if stack.source is not None:
            stack.request(HOLD)  # who has ended drives no further
        while stack.stopping or stack.arbiter.switching:
            with contextlib.suppress(ReflexError):
                stack.step()
            judge.observe(world)
        ended_by = ended_by if stack.reflex is None else "reflex"
        reflex = "" if stack.reflex is None else stack.reflex.message
        return SessionResult(
            np.array(measured),
            judge.outcome(world),
            latencies,
            stack.refusals,
            ended_by,
            reflex,
        )

    def _hand_over(self, judge: Judge) -> None:
        self.stack.request(SOURCE)
        while (out := self.stack.arbitrate()).switched_to != SOURCE:
            self._move(judge, self.stack.every)
            reflex = self.stack.reflex
            if reflex is not None or out.state == ArbiterState.STOPPED:
                reason = out.refusals[-1].detail if reflex is None else reflex.message
                raise HandoverError(f"the arbiter did not hand over: {reason}")

    def _move(self, judge: Judge, steps: int) -> None:
        for _ in range(steps):
            if self.stack.reflex is None:
                with contextlib.suppress(ReflexError):
                    self.stack.advance()
                judge.observe(self.world)
