"""Measures mode switches at every control step."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from minidual.config.arbiter import ArbiterConfig
from minidual.control.commands import ArbiterState
from minidual.control.stack import ControlStack
from minidual.plant.world import World
from minidual.robot.pair import Array

WINDOW_S = 0.5
"""Measurement continues this long after the first command."""
_LOG_EVERY = 4
_DRIVEN = (ArbiterState.ALIGNING, ArbiterState.ACTIVE)
_COLUMNS = (
    "time_s",
    "mode",
    "active_source",
    "state",
    "controllers",
    "reference_step_max_rad",
    "torque_step_max_nm",
    "torque_step_asked_max_nm",
)


@dataclass
class Switch:
    """One measured switch.

    Attributes:
        confirmed_s: When the arms were at rest.
        first_command_s: When its first command was accepted.
        first_step_rad: Measured posture to first target, worst joint.
        target_step_rad: Largest target step while the source drove.
        reference_step_ratio: Largest reference step over the velocity limit.
        torque_step_nm: Largest commanded torque step.
        torque_step_asked_nm: Before the supervisor's limits.
        torque_step_max_nm: Its bound.
    """

    mode: str
    requested_s: float
    confirmed_s: float = float("nan")
    first_command_s: float = float("nan")
    speed_at_request_rad_s: float = 0.0
    first_step_rad: float = float("nan")
    target_step_rad: float = 0.0
    reference_step_rad: float = 0.0
    reference_step_ratio: float = 0.0
    torque_step_nm: float = 0.0
    torque_step_joint: str = ""
    torque_step_asked_nm: float = 0.0
    torque_step_max_nm: float = 1.0
    controllers: tuple[str, ...] = ()

    def bounds(self, arbiter: ArbiterConfig) -> tuple[tuple[str, float, float], ...]:
        """Return (name, value, bound) of bounded values."""
        return (
            ("first_step_rad", self.first_step_rad, arbiter.switch_step_max_rad),
            ("target_step_rad", self.target_step_rad, arbiter.switch_step_max_rad),
            ("reference_step_ratio", self.reference_step_ratio, 1.0),
            ("torque_step_nm", self.torque_step_nm, self.torque_step_max_nm),
        )

    def faults(self, arbiter: ArbiterConfig) -> list[str]:
        """Return the exceeded bounds; NaN exceeds all."""
        return [
            f"switch to {self.mode} at {self.requested_s:.2f} s: {name} {value:.4g}, bound {bound:g}"
            for name, value, bound in self.bounds(arbiter)
            if not value <= bound + 1e-9
        ]


@dataclass(frozen=True)
class _Sample:
    reference: Array
    applied: Array
    asked: Array
    target: Array


@dataclass
class Recorder:
    """Watches a stack; call `observe` every control step."""

    stack: ControlStack[World]
    switches: list[Switch] = field(default_factory=list)
    rows: list[tuple[Any, ...]] = field(default_factory=list)
    _last: _Sample | None = None
    _steps: int = 0

    def requested(self, mode: str) -> None:
        """Begin a switch."""
        world = self.stack.plant
        speed = float(np.abs(world.v).max())
        largest = world.robot.arm.tau_rate_max * world.dt
        self.switches.append(Switch(mode, world.time, speed_at_request_rad_s=speed, torque_step_max_nm=largest))

    def confirmed(self) -> None:
        """Record the confirmation."""
        switch = self.switches[-1]
        switch.confirmed_s = self.stack.plant.time
        switch.controllers = self.stack.manager.active

    def observe(self) -> None:
        """Record the last control step."""
        stack = self.stack
        now = _Sample(np.array(stack.reference), np.array(stack.applied), np.array(stack.tau), stack.output.q_target)
        last = now if self._last is None else self._last
        reference = np.abs(now.reference - last.reference)
        applied, asked = np.abs(now.applied - last.applied), np.abs(now.asked - last.asked)
        if self.switches:
            self._watch(self.switches[-1], now.target, last.target, reference, applied, asked)
        if self._steps % _LOG_EVERY == 0:
            mode = self.switches[-1].mode if self.switches else ""
            source, state, active = stack.output.active_source or "", str(stack.state), stack.manager.active
            steps = (float(np.max(x)) for x in (reference, applied, asked))
            self.rows.append((stack.plant.time, mode, source, state, " ".join(active), *steps))
        self._last = now
        self._steps += 1

    def _watch(
        self, switch: Switch, target: Array, last_target: Array, reference: Array, applied: Array, asked: Array
    ) -> None:
        stack, now = self.stack, self.stack.plant.time
        driven = stack.output.active_source == switch.mode
        if driven and np.isnan(switch.first_command_s):
            switch.first_command_s = now
            switch.first_step_rad = float(np.max(np.abs(target - stack.plant.q)))
        if now > switch.first_command_s + WINDOW_S:  # false while first_command_s is NaN
            return
        if driven and stack.state in _DRIVEN:
            switch.target_step_rad = _larger(switch.target_step_rad, np.abs(target - last_target))
        switch.reference_step_rad = _larger(switch.reference_step_rad, reference)
        switch.reference_step_ratio = _larger(
            switch.reference_step_ratio, reference / (stack.plant.robot.v_max * stack.plant.dt)
        )
        switch.torque_step_asked_nm = _larger(switch.torque_step_asked_nm, asked)
        largest = _larger(switch.torque_step_nm, applied)
        if largest != switch.torque_step_nm:
            switch.torque_step_nm = largest
            switch.torque_step_joint = stack.plant.robot.joint_names[int(np.argmax(applied))]

    def write_csv(self, path: Path) -> None:
        """Write every fourth control step."""
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(_COLUMNS)
            for t, mode, source, state, controllers, *steps in self.rows:
                writer.writerow([f"{t:.3f}", mode, source, state, controllers, *(f"{x:.6g}" for x in steps)])


def _larger(so_far: float, steps: Array) -> float:
    """Return the larger value; NaN stays NaN, so that its bound fails."""
    return float(np.maximum(so_far, np.max(steps)))
