"""Demonstration: planner, leader and policy drive one plant in turn, measured at every control step."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from minidual.config.control import ArbiterConfig
from minidual.control.commands import SOURCES, ArbiterState
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.errors import DataError, UsageError, check_name
from minidual.plant.world import World
from minidual.robot.pair import Array
from minidual.trials.modes_turns import SwitchError, Turn

DEFAULT_MODES: tuple[str, ...] = ("moveit", "teleop", "policy", "moveit")
WINDOW_S = 0.5
"""Measurement of a switch continues this long after the first command."""
_LOG_EVERY = 4
_DRIVEN = (ArbiterState.ALIGNING, ArbiterState.ACTIVE)


def parse_modes(text: str) -> tuple[str, ...]:
    """Return the modes named in `moveit,teleop,moveit`.

    Raises:
        UsageError: Unknown or no mode, or one twice in sequence.
    """
    if not (modes := tuple(m.strip() for m in text.split(",") if m.strip())):
        raise UsageError("no mode named", remedy=f"--modes {','.join(DEFAULT_MODES)}")
    for before, mode in zip(("", *modes), modes, strict=False):
        check_name("mode", mode, SOURCES)
        if mode == before:
            raise UsageError(f"mode '{mode}' is named twice in sequence: that is no switch")
    return modes


@dataclass
class Switch:
    """One measured switch.

    Attributes:
        confirmed_s: When the arms were at rest.
        first_step_rad: Measured posture to first target, worst joint.
        target_step_rad: Largest while the source drove.
        reference_step_ratio: Largest reference step over the velocity limit.
        torque_step_nm: Largest commanded torque step.
        torque_step_asked_nm: The same before the supervisor's limits.
    """

    mode: str
    requested_s: float
    confirmed_s: float = float("nan")
    first_command_s: float = float("nan")
    speed_at_request_rad_s: float = 0.0
    first_step_rad: float = float("nan")
    target_step_rad: float = 0.0
    reference_step_ratio: float = 0.0
    torque_step_nm: float = 0.0
    torque_step_asked_nm: float = 0.0
    torque_step_max_nm: float = 1.0
    controllers: tuple[str, ...] = ()

    def bounds(self, arbiter: ArbiterConfig) -> dict[str, tuple[float, float]]:
        """Return {name: (value, bound)}."""
        return {
            "first_step_rad": (self.first_step_rad, arbiter.switch_step_max_rad),
            "target_step_rad": (self.target_step_rad, arbiter.switch_step_max_rad),
            "reference_step_ratio": (self.reference_step_ratio, 1.0),
            "torque_step_nm": (self.torque_step_nm, self.torque_step_max_nm),
        }


class ModesDemo:
    """Runs the turns of one stack; iterate `steps`, then read the measurements.

    Attributes:
        turn: None before the first.
        outcomes: Of the completed turns.
        rows: Log of every fourth control step.
        ended: Why it ended early, or None.
    """

    def __init__(self, stack: ControlStack[World], turns: Sequence[Turn]) -> None:
        self.stack = stack
        self._turns = tuple(turns)
        self.turn: Turn | None = None
        self.switches: list[Switch] = []
        self.outcomes: list[dict[str, Any]] = []
        self.rows: list[Mapping[str, object]] = []
        self.ended: str | None = None
        self._last: Array | None = None
        self._steps = 0

    def steps(self) -> Iterator[Turn]:
        """Run; yield the current turn after every control step.

        A mode that does not get the arms or loses them, a refused trajectory and a reflex end it early.
        """
        try:
            for turn in self._turns:
                yield from self._drive(turn)
        except Exception as error:
            self.ended = str(error)
            if self.stack.reflex is None and self.turn is not None:
                self.stack.halt(self.turn.mode)
            while self.stack.stopping:
                with suppress(ReflexError):  # the arms come to rest all the same
                    self.stack.step()
            if not isinstance(error, SwitchError | ReflexError | DataError):
                raise

    def _drive(self, turn: Turn) -> Iterator[Turn]:
        stack = self.stack
        world = self.stack.plant
        self.turn = turn
        switch = Switch(turn.mode, world.time, speed_at_request_rad_s=float(np.abs(world.v).max()))
        switch.torque_step_max_nm = world.robot.arm.tau_rate_max * world.dt
        self.switches.append(switch)
        stack.request(turn.mode, turn.controllers)
        while stack.source != turn.mode:
            self._step()
            yield turn
        switch.confirmed_s = world.time
        switch.controllers = stack.manager.active
        for _ in self._driven(turn):
            self._step()
            yield turn

    def _driven(self, turn: Turn) -> Iterator[None]:
        result = yield from turn.drive()
        self.outcomes.append({"mode": turn.mode, **result})

    def exceeded(self, arbiter: ArbiterConfig) -> list[str]:
        """Return the exceeded bounds of all switches; NaN exceeds all."""
        return [
            f"switch to {s.mode} at {s.requested_s:.2f} s: {name} {value:.4g}, bound {bound:g}"
            for s in self.switches
            for name, (value, bound) in s.bounds(arbiter).items()
            if not value <= bound + 1e-9
        ]

    def record(self, arbiter: ArbiterConfig) -> dict[str, Any]:
        """Return the measurements as plain data."""
        named = [(s.mode, s.bounds(arbiter).items()) for s in self.switches]
        return {
            "switches": [asdict(s) for s in self.switches],
            "bounds": [
                {"mode": mode, **{n: {"value": v, "bound": b} for n, (v, b) in of}}
                for mode, of in named
            ],
            "outcomes": self.outcomes,
            "exceeded": self.exceeded(arbiter),
            "refusals": [asdict(r) for r in self.stack.refusals],
            "duration_s": self.stack.plant.time,
            "ended": self.ended,
        }

    def _step(self) -> None:
        stack = self.stack
        switch = self.switches[-1]
        stack.step()
        now = np.array(
            [stack.output.q_target, stack.manager.reference, stack.applied, stack.manager.tau],
        )
        steps = np.abs(now - (now if self._last is None else self._last))
        self._last = now
        self._measure(switch, *steps)
        if self._steps % _LOG_EVERY == 0:
            names = ("reference_step_max_rad", "torque_step_max_nm", "torque_step_asked_max_nm")
            largest = {
                name: f"{x:.6g}" for name, x in zip(names, steps[1:].max(axis=1), strict=True)
            }
            row = {"time_s": f"{stack.plant.time:.3f}", "mode": switch.mode}
            row |= {"active_source": stack.output.active_source or "", "state": str(stack.state)}
            self.rows.append({**row, "controllers": " ".join(stack.manager.active), **largest})
        self._steps += 1
        if stack.state == ArbiterState.STOPPED:
            last = stack.refusals[-1].detail if stack.refusals else "no command came"
            raise SwitchError(
                f"mode '{switch.mode}' lost its turn at {stack.plant.time:.2f} s: {last}",
            )

    def _measure(
        self,
        switch: Switch,
        target: Array,
        reference: Array,
        applied: Array,
        asked: Array,
    ) -> None:
        stack = self.stack
        plant = self.stack.plant
        driven = stack.output.active_source == switch.mode
        if driven and np.isnan(switch.first_command_s):
            switch.first_command_s = plant.time
            switch.first_step_rad = float(np.max(np.abs(stack.output.q_target - plant.q)))
        if plant.time > switch.first_command_s + WINDOW_S:  # false while first_command_s is NaN
            return
        if driven and stack.state in _DRIVEN:
            switch.target_step_rad = _larger(switch.target_step_rad, target)
        switch.reference_step_ratio = _larger(
            switch.reference_step_ratio,
            reference / (plant.robot.v_max * plant.dt),
        )
        switch.torque_step_nm = _larger(switch.torque_step_nm, applied)
        switch.torque_step_asked_nm = _larger(switch.torque_step_asked_nm, asked)


def _larger(so_far: float, steps: Array) -> float:
    return float(np.maximum(so_far, np.max(steps)))
