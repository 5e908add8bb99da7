"""Latency of commands and emergency stops through arbiter, controller and supervisor."""

from __future__ import annotations

import time
from dataclasses import dataclass
from unittest.mock import patch

import numpy as np

from minidual.config.arbiter import ArbiterConfig
from minidual.config.supervisor import SupervisorConfig
from minidual.control.commands import JointCommand
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import MinidualError
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array

_SOURCE = "policy"
_NUDGE_RAD = 0.02
_CHANGED_SHARE = 0.5
"""Share of the supervisor's torque step (1 Nm) that counts as a response.

The nudge asks for twenty times that; the previous one leaves a hundredth.
"""
_SETTLE_STEPS = 120
_STILL_RAD_S = 0.01
_SWING_RAD, _SWINGS_S, _REST_MAX_S = 0.3, 2.0, 2.0


@dataclass(frozen=True)
class CommandLatency:
    """Latency of commands.

    Attributes:
        ticks: Control steps from `propose` to the first changed torque, per instant of the arbiter's period; 1 is the
            next step.
        period_ticks: Control steps per arbiter tick.
        wall_us: Wall time from `propose` to the motors, just before an arbiter tick [us].
    """

    ticks: tuple[int, ...]
    period_ticks: int
    wall_us: Array


class LatencyRig:
    """The control stack with one source, on a reset world."""

    def __init__(
        self, world: World, kinematics: Kinematics, arbiter: ArbiterConfig, supervisor: SupervisorConfig, rate_hz: float
    ) -> None:
        self.world = world
        world.reset()
        self.supervisor = Supervisor(supervisor, dt_s=world.dt, kinematics=Kinematics(world.robot))
        self.stack = ControlStack(world, kinematics, arbiter, rate_hz=rate_hz, supervisor=self.supervisor)
        self.period = round(1.0 / (rate_hz * world.dt))
        self.target = world.q
        self._sequence = 0
        self.stack.request(_SOURCE)
        for _ in range(2 * _SETTLE_STEPS):
            self.hold_step()
        if self.stack.source != _SOURCE:
            raise MinidualError(f"'{_SOURCE}' did not get the arms: the arbiter is {self.stack.state}")

    def propose(self) -> None:
        """Propose the present target, stamped now."""
        self._sequence += 1
        command = JointCommand(self.target.copy(), np.ones(2), self.world.time, self._sequence)
        self.stack.propose(_SOURCE, command)

    def hold_step(self) -> None:
        """Run one step; keep the source alive."""
        if self.stack.tick_next:
            self.propose()
        self.stack.step()

    def nudge(self, sign: float) -> None:
        """Move the target of the left joint 1 to one side of home."""
        self.target[0] = self.world.robot.home[0] + sign * 0.5 * _NUDGE_RAD


def command_latency(rig: LatencyRig, *, repeats_n: int = 100) -> CommandLatency:
    """Measure command latency at each instant of the arbiter's period."""
    ticks, sign = [], 1.0
    for phase in range(rig.period):
        for _ in range(_SETTLE_STEPS):
            rig.hold_step()
        while not rig.stack.tick_next:
            rig.hold_step()
        for _ in range(phase):
            rig.hold_step()
        sign = -sign
        rig.nudge(sign)
        rig.propose()
        ticks.append(_steps_until_torque(rig))
    wall = np.empty(repeats_n)
    for k in range(repeats_n):
        while not rig.stack.tick_next:
            rig.hold_step()
        sign = -sign
        rig.nudge(sign)
        wall[k] = _wall_us(rig)
    return CommandLatency(tuple(ticks), rig.period, wall)


def _steps_until_torque(rig: LatencyRig) -> int:
    """Return the steps to a torque response; three periods if none."""
    changed_nm = _CHANGED_SHARE * rig.supervisor.bounds.tau_step
    for count in range(1, 3 * rig.period + 1):
        before = rig.stack.applied.copy()
        rig.stack.step()
        if np.max(np.abs(rig.stack.applied - before)) > changed_nm:
            return count
    return 3 * rig.period


def _wall_us(rig: LatencyRig) -> float:
    """Return the wall time from propose to the torque command [us]."""
    reached: list[int] = []
    command = rig.world.command

    def stamped(tau: Array, fingers: Array) -> None:
        reached.append(time.perf_counter_ns())
        command(tau, fingers)

    with patch.object(rig.world, "command", stamped):
        began = time.perf_counter_ns()
        rig.propose()
        rig.stack.step()
    return (reached[0] - began) / 1e3


@dataclass(frozen=True)
class StopResponse:
    """Response of moving arms to an emergency stop.

    Attributes:
        ticks: Control steps to the reflex `emergency_stop`; 1 is the next, 0 means none.
        rest_s: Simulated time from the reflex until all joints are below 0.01 rad/s; NaN after 2 s.
        speed_rad_s: Fastest joint at the call.
    """

    ticks: int
    rest_s: float
    speed_rad_s: float


def emergency_stop(rig: LatencyRig) -> StopResponse:
    """Swing all joints, stop at the fastest instant, and measure until rest."""
    world, supervisor, home = rig.world, rig.supervisor, rig.world.robot.home
    press = round(_SWINGS_S / world.dt)
    speed, ticks = 0.0, 0
    for k in range(press + round(_REST_MAX_S / world.dt)):
        rig.target = home + _SWING_RAD * np.sin(2.0 * np.pi * k * world.dt / _SWINGS_S)
        if k == press:
            speed = float(np.max(np.abs(world.v)))
            supervisor.estop("environment check")
        try:
            rig.hold_step()
        except ReflexError as error:
            if k >= press and error.reflex.name == "emergency_stop":
                ticks = k + 1 - press
        if supervisor.reflex is not None and np.max(np.abs(world.v)) < _STILL_RAD_S:
            return StopResponse(ticks, world.time - supervisor.reflex.time_s, speed)
    return StopResponse(ticks, float("nan"), speed)
