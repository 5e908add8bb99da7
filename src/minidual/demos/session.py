"""One teleoperated episode; ticks follow simulated time."""

import contextlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from minidual.config.learning import MirrorConfig, TeleopConfig
from minidual.control.commands import HOLD, ArbiterState, JointCommand, Refusal
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.demos.leader import Leader
from minidual.errors import MinidualError, UsageError
from minidual.plant.render import Image, StampedImage
from minidual.plant.world import World
from minidual.robot.pair import Array, Robot
from minidual.tasks.judge import Judge, Outcome, begin
from minidual.tasks.task import Task, Trial

SOURCE = "teleop"
_BEYOND_LIMIT_RAD = 0.3
"""A reading further beyond a joint limit is no person's arm.

It is in degrees, a turn off, or infinite: the arbiter refuses it.
"""

EndedBy = Literal["leader", "time_limit", "stopped", "reflex"]


class HandoverError(MinidualError):
    """The arbiter did not accept the leader."""


def check_start(robot: Robot, config: MirrorConfig, q_leader: Array, q_follower: Array) -> None:
    """Raise UsageError if a joint of leader and follower differs by more than the limit."""
    difference = follower_target(robot, q_leader) - q_follower
    worst = int(np.argmax(np.abs(difference)))
    limit = config.start_error_max_rad
    if abs(difference[worst]) > limit:
        joints_over_n = int(np.sum(np.abs(difference) > limit))
        raise UsageError(
            f"the leader starts {difference[worst]:+.3f} rad away from the follower "
            f"at {robot.joint_names[worst]} "
            f"({joints_over_n} of {robot.dof} joints over the limit of {limit} rad)",
            remedy=(
                "bring the leader to the follower's posture; "
                "check the joint order, the signs and the offsets"
            ),
        )


def follower_target(robot: Robot, q_leader: Array) -> Array:
    """Return the leader's joints clipped to the follower's limits (n,) [rad].

    All zeros (lost values), NaN and values far beyond a limit pass unchanged, so that the arbiter
    refuses them.

    Raises:
        UsageError: Another shape.
    """
    q = np.asarray(q_leader, dtype=float)
    if q.shape != (robot.dof,):
        raise UsageError(
            f"the leader gives joints of shape {q.shape}; "
            f"it must be ({robot.dof},), left then right",
        )
    clipped = np.clip(q, robot.q_lower, robot.q_upper)
    plausible = bool(q.any()) and bool(np.abs(clipped - q).max() < _BEYOND_LIMIT_RAD)
    return clipped if plausible else q


class Tick(NamedTuple):
    """What was measured at one tick, and the command that followed.

    Names and shapes are those of the schema.

    Attributes:
        image_timestamps: Stamp of the picture that is furthest from the joints in time; None
            without pictures.
    """

    timestamps: float
    image_timestamps: float | None
    qpos: Array
    qvel: Array
    gripper: Array
    images: dict[str, Image]
    action: Array
    action_gripper: Array


def _furthest_stamp(pictures: Mapping[str, StampedImage], joints_stamp_s: float) -> float | None:
    """Return the stamp furthest from that of the joints [s], or None without pictures."""
    stamps_s = [picture.stamp_s for picture in pictures.values()]
    return max(stamps_s, key=lambda stamp_s: abs(stamp_s - joints_stamp_s), default=None)


@dataclass
class SessionResult:
    """One episode.

    Attributes:
        q: (T, n) measured joints [rad]; images go to `on_tick` only.
        latencies_s: Wall time per tick from reading the leader to the end of the first physics
            step.
        ended_by: "stopped": no readings came.
    """

    q: Array
    outcome: Outcome
    latencies_s: list[float]
    refusals: list[Refusal] = field(default_factory=list)
    ended_by: EndedBy = "leader"
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
            refusal = self.refusals[0]
            return f"the arbiter refused {refusal.name}: {refusal.detail}"
        if self.success:
            return ""
        return self.outcome.reason or "the leader did not end the episode in time"


class _TickRun(NamedTuple):
    """One tick that was run.

    Attributes:
        stopped: Whether the arbiter stopped the arms, because no readings came.
    """

    tick: Tick
    latency_s: float
    stopped: bool


@dataclass
class _Drive:
    """What driving the arms gave; see `SessionResult`."""

    q: list[Array] = field(default_factory=list)
    latencies_s: list[float] = field(default_factory=list)
    ended_by: EndedBy = "time_limit"


class TeleopSession:
    """Runs episodes in the stack's world, at its rate; a reflex ends the episode.

    `pictures` returns the stamped images by camera, as recorded.
    """

    def __init__(
        self,
        stack: ControlStack[World],
        config: TeleopConfig,
        pictures: Callable[[], dict[str, StampedImage]] = dict,
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
        judge = self._start(task, trial, leader)
        try:
            return self._run(judge, leader, on_tick)
        except Exception as error:
            with contextlib.suppress(ReflexError):
                self.stack.fail(error)
                self.stack.advance()
            while self.stack.stopping:
                self.stack.advance()
            raise

    def _start(self, task: Task, trial: Trial, leader: Leader) -> Judge:
        """Set up the trial, with the leader at the arms' posture; nothing moves."""
        judge = begin(self.world, task, trial)
        self.stack.reset()
        first_reading = leader.read(0.0)
        if first_reading is not None:
            check_start(self.world.robot, self.config.mirror, first_reading[0], self.world.q)
        return judge

    def _run(
        self,
        judge: Judge,
        leader: Leader,
        on_tick: Callable[[Tick], None],
    ) -> SessionResult:
        self._hand_over(judge)
        drive = self._drive(judge, leader, on_tick)
        self._come_to_rest(judge)
        reflex = self.stack.reflex
        return SessionResult(
            q=np.array(drive.q),
            outcome=judge.outcome(self.world),
            latencies_s=drive.latencies_s,
            refusals=self.stack.refusals,
            ended_by=drive.ended_by if reflex is None else "reflex",
            reflex="" if reflex is None else reflex.message,
        )

    def _hand_over(self, judge: Judge) -> None:
        """Run until the arbiter forwards the leader."""
        self.stack.request(SOURCE)
        output = self.stack.arbitrate()
        while output.switched_to != SOURCE:
            self._move(judge, self.stack.every)
            reflex = self.stack.reflex
            if reflex is not None:
                raise HandoverError(f"the arbiter did not hand over: {reflex.message}")
            if output.state == ArbiterState.STOPPED:
                reason = output.refusals[-1].detail
                raise HandoverError(f"the arbiter did not hand over: {reason}")
            output = self.stack.arbitrate()

    def _drive(self, judge: Judge, leader: Leader, on_tick: Callable[[Tick], None]) -> _Drive:
        """Let the leader drive until the episode ends."""
        drive = _Drive()
        period_s = 1.0 / self.config.rate_hz
        began = time.monotonic()
        for k in range(self._ticks_max(leader)):
            elapsed_s = k * period_s
            if leader.finished(elapsed_s):
                drive.ended_by = "leader"
                break
            if leader.realtime:
                time.sleep(max(0.0, began + elapsed_s - time.monotonic()))
            run = self._tick(k, elapsed_s, judge, leader)
            drive.latencies_s.append(run.latency_s)
            drive.q.append(run.tick.qpos)
            on_tick(run.tick)
            if run.stopped:
                drive.ended_by = "stopped"
                break
            self._move(judge, self.stack.every - 1)
            if self.stack.reflex is not None:
                break
        return drive

    def _ticks_max(self, leader: Leader) -> int:
        # The judge applies the task's own limit to people too.
        if leader.realtime:
            limit_s = self.config.person_time_limit_s
        else:
            limit_s = self.world.scene.task.time_limit_s
        return round(limit_s * self.config.rate_hz)

    def _tick(self, k: int, elapsed_s: float, judge: Judge, leader: Leader) -> _TickRun:
        """Measure, read the leader, command, and run the first physics step."""
        world = self.world
        stamp_s = world.stamp_s
        q = world.q
        v = world.v
        gripper = world.gripper
        pictures = self._pictures()
        started = time.perf_counter()
        reading = leader.read(elapsed_s)
        if reading is not None:
            q_leader, openings = reading
            target = follower_target(world.robot, q_leader)
            self.stack.propose(SOURCE, JointCommand(target, openings, stamp_s, k))
        output = self.stack.arbitrate()
        tick = Tick(
            timestamps=stamp_s,
            image_timestamps=_furthest_stamp(pictures, stamp_s),
            qpos=q,
            qvel=v,
            gripper=gripper,
            images={name: picture.image for name, picture in pictures.items()},
            action=output.q_target,
            action_gripper=output.gripper,
        )
        self._move(judge, 1)
        latency_s = time.perf_counter() - started
        return _TickRun(tick, latency_s, output.state == ArbiterState.STOPPED)

    def _come_to_rest(self, judge: Judge) -> None:
        if self.stack.source is not None:
            self.stack.request(HOLD)  # a leader whose episode has ended must not drive on
        while self.stack.stopping or self.stack.arbiter.switching:
            with contextlib.suppress(ReflexError):
                self.stack.step()
            judge.observe(self.world)

    def _move(self, judge: Judge, steps: int) -> None:
        """Run physics steps, none after a reflex."""
        for _ in range(steps):
            if self.stack.reflex is None:
                with contextlib.suppress(ReflexError):
                    self.stack.advance()
                judge.observe(self.world)
