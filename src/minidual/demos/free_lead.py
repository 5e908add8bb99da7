"""A leader drives any plant, without a task, a judge or a recording."""

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from minidual.config.learning import TeleopConfig
from minidual.control.commands import HOLD, ArbiterState, JointCommand, Refusal
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.demos.leader import Feedback, Leader
from minidual.demos.mirror import Mirror, Mirrored
from minidual.demos.seat import Seat
from minidual.demos.session import SOURCE, HandoverError
from minidual.demos.station import Station
from minidual.plant.protocol import Plant, openings_of
from minidual.robot.pair import Array
from minidual.tasks.task import Trial

_GIVEN_MAX_S = 2.0


class LeadTick(NamedTuple):
    """One tick.

    Attributes:
        time_s: On the plant's clock.
        q: Measured joints (n,) [rad].
        action: What the arbiter commanded (n,) [rad].
        gripper: Measured openings (2,).
        age_s: Of the leader's reading; NaN if it does not tell, or gave none.
        command_s: Wall time from reading the leader to the command, without waiting for the plant.
    """

    time_s: float
    q: Array
    action: Array
    gripper: Array
    age_s: float
    command_s: float


@dataclass
class Led:
    """How it went.

    Attributes:
        ended_by: "time", "silence", "reflex", or the button.
        wall_s: Wall time of all ticks.
        reflex: Why the supervisor stopped the arms, or "".
        held: Why the arms did not follow at the end, or "".
    """

    ticks: list[LeadTick] = field(default_factory=list)
    refusals: list[Refusal] = field(default_factory=list)
    ended_by: str = "time"
    wall_s: float = 0.0
    reflex: str = ""
    held: str = ""


class FreeLead:
    """One session.

    Args:
        stack: Of the plant; its rate is that of the leader's targets.
        config: Section `teleop`.
        leader: Connected.
        station: Where the person stands who leads.
        draw: Draws the plant once: while it waits, and at each tick.
    """

    def __init__(
        self,
        stack: ControlStack[Plant],
        config: TeleopConfig,
        leader: Leader,
        station: Station,
        draw: Callable[[], None] = lambda: None,
    ) -> None:
        self._stack = stack
        self._plant = stack.plant
        self._leader = leader
        self._mirror = Mirror(leader, stack.plant.robot, config)
        self._seat = Seat(self._mirror, station, config, draw)
        self._draw = draw
        self._rate_hz = config.rate_hz
        self._began_s = 0.0

    def run(self, trial: Trial, seconds: float) -> Led:
        """Wait for the leader, follow it, and bring the arms to rest.

        Args:
            trial: For leaders that play one; others take only the posture.
            seconds: Longest time.

        Raises:
            UsageError: Leader and arms are apart, or nobody began.
            HandoverError: The arbiter refused.
        """
        led = Led()
        q = self._plant.q
        self._leader.align(trial, q)
        self._mirror.begin(q)
        button = self._seat.begin()
        if button is not None:
            led.ended_by = str(button)
            return led
        self._stack.reset()
        self._take_arms()
        began_s = time.perf_counter()
        try:
            self._drive(led, round(seconds * self._rate_hz))
        finally:
            led.wall_s = time.perf_counter() - began_s
            self._come_to_rest()
        led.refusals = self._stack.refusals
        led.held = self._mirror.gate.held
        reflex = self._stack.reflex
        if reflex is not None:
            led.ended_by = "reflex"
            led.reflex = reflex.message
        return led

    def _take_arms(self) -> None:
        stack = self._stack
        stack.request(SOURCE)
        end_s = self._plant.time + _GIVEN_MAX_S
        while stack.source != SOURCE:
            with contextlib.suppress(ReflexError):
                stack.step()
            if stack.reflex is not None:
                raise HandoverError(f"the arms were not given: {stack.reflex.message}")
            if self._plant.time > end_s:
                raise HandoverError(f"the arms were not given: the arbiter is {stack.state}")

    def _drive(self, led: Led, ticks_n: int) -> None:
        self._began_s = self._plant.time
        self._seat.start_clock()
        for k in range(ticks_n):
            button = self._seat.wait_for_tick(k)
            if button is None:
                self._tick(led, k)
                button = self._seat.ending
            if button is not None:
                led.ended_by = str(button)
                return
            if self._stack.reflex is not None:
                return
            if self._stack.state is ArbiterState.STOPPED:
                led.ended_by = "silence"
                return

    def _tick(self, led: Led, k: int) -> None:
        """Read the leader, command, and run until the next tick."""
        stack = self._stack
        plant = self._plant
        time_s = plant.time
        q = plant.q
        gripper = openings_of(plant)
        began_s = time.perf_counter()
        wanted = self._seat.read(k)
        if self._seat.ending is not None:
            return
        if wanted is not None:
            stack.propose(SOURCE, JointCommand(wanted.target, wanted.openings, time_s, k + 1))
        output = stack.arbitrate()
        command_s = time.perf_counter() - began_s
        action = np.array(output.q_target)
        led.ticks.append(LeadTick(time_s, q, action, gripper, _age_s(wanted), command_s))
        for _ in range(stack.every):
            with contextlib.suppress(ReflexError):
                stack.advance()
            if stack.reflex is not None:
                return
        self._draw()
        self._feed_back(time_s - self._began_s, q, gripper)

    def _feed_back(self, stamp_s: float, q: Array, gripper: Array) -> None:
        supervisor = self._stack.supervisor
        met_nm = supervisor.observer.external.copy()
        self._leader.feedback(Feedback(stamp_s, q, gripper, supervisor.touch, met_nm))
        if self._leader.violation is not None:
            supervisor.report(self._leader.violation)

    def _come_to_rest(self) -> None:
        stack = self._stack
        if stack.source is not None:
            stack.request(HOLD)
        while stack.stopping or stack.arbiter.switching:
            with contextlib.suppress(ReflexError):
                stack.step()


def _age_s(wanted: Mirrored | None) -> float:
    return float("nan") if wanted is None or wanted.age_s is None else wanted.age_s
