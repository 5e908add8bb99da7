"""One teleoperated episode.

Ticks follow simulated time, so load loses none.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from minidual.config.arbiter import ArbiterConfig
from minidual.config.teleop import TeleopConfig
from minidual.control.commands import ArbiterState, JointCommand, Refusal
from minidual.control.execution import ArbiterOutput
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.demos.leader import Leader
from minidual.demos.mirror import Mirror
from minidual.demos.observation import Observation, Observer
from minidual.errors import MinidualError
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.tasks.judge import Judge, Outcome, begin
from minidual.tasks.task import Task, Trial

SOURCE = "teleop"


class HandoverError(MinidualError):
    """The arbiter did not accept the leader."""


@dataclass(frozen=True)
class Tick:
    """An observation and its command: targets (n,) [rad], openings (2,)."""

    observation: Observation
    action: Array
    action_gripper: Array


@dataclass
class SessionResult:
    """One episode.

    Attributes:
        q: (T, n) joints [rad]; images may exceed memory and only go to `on_tick`.
        latencies_s: T wall times from reading the leader to the first physics step.
        ended_by: "leader", "time_limit", "stopped" (the leader fell silent) or "reflex".
        reflex: Message, or "".
    """

    q: Array
    outcome: Outcome
    latencies_s: list[float]
    refusals: list[Refusal] = field(default_factory=list)
    ended_by: str = "leader"
    reflex: str = ""

    @property
    def reason(self) -> str:
        """Why the episode is no demonstration, or ""."""
        if self.reflex:
            return self.reflex
        if self.ended_by == "stopped":
            return "the leader fell silent"
        if self.refusals:
            first = self.refusals[0]
            return f"the arbiter refused {first.name}: {first.detail}"
        return self.outcome.reason


class TeleopSession:
    """Runs episodes in one world; a reflex of `supervisor` ends the episode.

    Raises:
        UsageError: The rate does not divide the control rate.
    """

    def __init__(
        self,
        world: World,
        kinematics: Kinematics,
        observer: Observer,
        config: TeleopConfig,
        arbiter: ArbiterConfig,
        *,
        supervisor: Supervisor | None = None,
    ) -> None:
        self.world, self.observer, self.config = world, observer, config
        self.mirror = Mirror(world.robot, config.mirror)
        self._steps = round(1.0 / (config.rate_hz * world.dt))
        self.stack = ControlStack(world, kinematics, arbiter, rate_hz=config.rate_hz, supervisor=supervisor)

    def run(
        self, task: Task, trial: Trial, leader: Leader, *, on_tick: Callable[[int, Tick], None] | None = None
    ) -> SessionResult:
        """Run one episode; `on_tick` is called after each command.

        Raises:
            LeaderOffsetError: Leader and follower are apart.
            HandoverError: The arbiter refused.
        """
        world = self.world
        judge = begin(world, task, trial)
        self.stack.reset()
        first = leader.read(0.0)
        if first is not None:
            self.mirror.check_start(first[0], world.q)
        self._hand_over(judge)
        return self._follow(judge, leader, on_tick)

    def _hand_over(self, judge: Judge) -> None:
        self.stack.request(SOURCE)
        while True:
            out = self.stack.arbitrate()
            if out.switched_to == SOURCE:
                return
            if out.state == ArbiterState.STOPPED:
                raise HandoverError(f"the arbiter did not hand over: {out.refusals[-1].detail}")
            reflex = self._move(judge)
            if reflex:
                raise HandoverError(f"the arbiter did not hand over: {reflex}")

    def _follow(self, judge: Judge, leader: Leader, on_tick: Callable[[int, Tick], None] | None) -> SessionResult:
        world, period = self.world, 1.0 / self.config.rate_hz
        limit = round(self._time_limit_s(leader) * self.config.rate_hz)
        measured: list[Array] = []
        latencies: list[float] = []
        refusals: list[Refusal] = []
        ended_by, reflex, began = "time_limit", "", time.monotonic()
        for k in range(limit):
            elapsed = k * period
            if leader.finished(elapsed):
                ended_by = "leader"
                break
            if leader.realtime:
                time.sleep(max(0.0, began + elapsed - time.monotonic()))
            observation = self.observer.read()
            before = time.perf_counter()
            out = self._ask(leader, k, elapsed, observation)
            tick = Tick(observation, out.q_target, out.gripper)
            reflex = self._advance(judge)
            latencies.append(time.perf_counter() - before)
            refusals.extend(out.refusals)
            measured.append(observation.q)
            if on_tick is not None:
                on_tick(k, tick)
            if out.state == ArbiterState.STOPPED:
                ended_by = "stopped"
                break
            reflex = reflex or self._move(judge, self._steps - 1)
            if reflex:
                ended_by = "reflex"
                break
        return SessionResult(np.array(measured), judge.outcome(world), latencies, refusals, ended_by, reflex)

    def _ask(self, leader: Leader, k: int, elapsed_s: float, now: Observation) -> ArbiterOutput:
        reading = leader.read(elapsed_s)
        if reading is not None:
            command = JointCommand(self.mirror.target(reading[0]), reading[1], now.time_s, k)
            self.stack.propose(SOURCE, command)
        return self.stack.arbitrate()

    def _move(self, judge: Judge, steps: int | None = None) -> str:
        """Run control steps, by default a tick's; return the reflex."""
        for _ in range(self._steps if steps is None else steps):
            reflex = self._advance(judge)
            if reflex:
                return reflex
        return ""

    def _advance(self, judge: Judge) -> str:
        reflex = ""
        try:
            self.stack.advance()
        except ReflexError as error:
            reflex = error.message
        judge.observe(self.world)
        return reflex

    def _time_limit_s(self, leader: Leader) -> float:
        """Return a longer limit for people; the judge applies the task's."""
        return self.config.person_time_limit_s if leader.realtime else self.world.scene.task.time_limit_s
