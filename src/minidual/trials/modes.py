"""Planner, leader and policy drive one plant in turn; every control step is measured."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from minidual.config.control import ArbiterConfig
from minidual.control.commands import SOURCES, ArbiterState
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.errors import DataError, UsageError, check_name
from minidual.plant.protocol import Plant
from minidual.robot.pair import Array
from minidual.trials.modes_turns import SwitchError, Turn

DEFAULT_MODES: tuple[str, ...] = ("moveit", "teleop", "policy", "moveit")
WINDOW_S = 0.5
"""Measurement of a switch continues this long after the first command."""
_LOG_EVERY_S = 0.004
_DRIVEN = (ArbiterState.ALIGNING, ArbiterState.ACTIVE)


def parse_modes(text: str) -> tuple[str, ...]:
    """Return the modes named in `moveit,teleop,moveit`.

    Raises:
        UsageError: Unknown or no mode, or one twice in sequence.
    """
    modes = tuple(mode.strip() for mode in text.split(",") if mode.strip())
    if not modes:
        raise UsageError("no mode named", remedy=f"--modes {','.join(DEFAULT_MODES)}")
    for before, mode in zip(("", *modes), modes, strict=False):
        check_name("mode", mode, SOURCES)
        if mode == before:
            raise UsageError(f"mode '{mode}' is named twice in sequence: that is no switch")
    return modes


class Bounded(NamedTuple):
    """A measured value and its bound."""

    value: float
    bound: float

    @property
    def exceeded(self) -> bool:
        """Whether the bound is exceeded; NaN exceeds it."""
        return not self.value <= self.bound + 1e-9


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

    def bounds(self, arbiter: ArbiterConfig) -> dict[str, Bounded]:
        """Return the measured values that have a bound, by name."""
        return {
            "first_step_rad": Bounded(self.first_step_rad, arbiter.switch_step_max_rad),
            "target_step_rad": Bounded(self.target_step_rad, arbiter.switch_step_max_rad),
            "reference_step_ratio": Bounded(self.reference_step_ratio, 1.0),
            "torque_step_nm": Bounded(self.torque_step_nm, self.torque_step_max_nm),
        }


@dataclass(frozen=True)
class _Setpoints:
    """Commands of the stack at one step, (n,) each."""

    target: Array
    reference: Array
    applied_torque: Array
    asked_torque: Array

    @classmethod
    def of(cls, stack: ControlStack[Plant]) -> "_Setpoints":
        return cls(
            target=np.array(stack.output.q_target),
            reference=np.array(stack.manager.reference),
            applied_torque=np.array(stack.applied),
            asked_torque=np.array(stack.manager.tau),
        )

    def steps_from(self, last: "_Setpoints") -> "_Setpoints":
        """Return the size of the step from the last set-points, of each joint."""
        return _Setpoints(
            target=np.abs(self.target - last.target),
            reference=np.abs(self.reference - last.reference),
            applied_torque=np.abs(self.applied_torque - last.applied_torque),
            asked_torque=np.abs(self.asked_torque - last.asked_torque),
        )


class ModesDemo:
    """Runs the turns of one stack; iterate `steps`, then read the measurements.

    Attributes:
        turn: None before the first.
        outcomes: Of the completed turns.
        rows: Log of every 4 ms, or of every control step.
        ended: Why it ended early, or None.
    """

    def __init__(self, stack: ControlStack[Plant], turns: Sequence[Turn]) -> None:
        self.stack = stack
        self._turns = tuple(turns)
        self.turn: Turn | None = None
        self.switches: list[Switch] = []
        self.outcomes: list[dict[str, Any]] = []
        self.rows: list[Mapping[str, object]] = []
        self.ended: str | None = None
        self._last: _Setpoints | None = None
        self._steps = 0
        self._log_every = max(1, round(_LOG_EVERY_S / stack.plant.dt))

    def steps(self) -> Iterator[Turn]:
        """Run; yield the current turn after every control step.

        A mode that does not get the arms or loses them, a refused trajectory and a reflex end it
        early.
        """
        try:
            for turn in self._turns:
                yield from self._drive(turn)
        except Exception as error:
            self.ended = str(error)
            self._stop()
            if not isinstance(error, SwitchError | ReflexError | DataError):
                raise

    def _stop(self) -> None:
        """Bring the arms to rest."""
        if self.stack.reflex is None and self.turn is not None:
            self.stack.halt(self.turn.mode)
        while self.stack.stopping:
            with suppress(ReflexError):  # the arms come to rest all the same
                self.stack.step()

    def _drive(self, turn: Turn) -> Iterator[Turn]:
        stack = self.stack
        plant = stack.plant
        self.turn = turn
        switch = Switch(
            turn.mode,
            plant.time,
            speed_at_request_rad_s=float(np.abs(plant.v).max()),
            torque_step_max_nm=plant.robot.tau_rate_max * plant.dt,
        )
        self.switches.append(switch)
        stack.request(turn.mode, turn.controllers)
        while stack.source != turn.mode:
            self._step()
            yield turn
        switch.confirmed_s = plant.time
        switch.controllers = stack.manager.active
        for _ in self._driven(turn):
            self._step()
            yield turn

    def _driven(self, turn: Turn) -> Iterator[None]:
        result = yield from turn.drive()
        self.outcomes.append({"mode": turn.mode, **result})

    def exceeded(self, arbiter: ArbiterConfig) -> list[str]:
        """Return the exceeded bounds of all switches as text; NaN exceeds all."""
        lines: list[str] = []
        for switch in self.switches:
            title = f"switch to {switch.mode} at {switch.requested_s:.2f} s"
            for name, measured in switch.bounds(arbiter).items():
                if measured.exceeded:
                    value = f"{name} {measured.value:.4g}"
                    lines.append(f"{title}: {value}, bound {measured.bound:g}")
        return lines

    def record(self, arbiter: ArbiterConfig) -> dict[str, Any]:
        """Return the measurements as plain data."""
        bounds: list[dict[str, Any]] = []
        for switch in self.switches:
            row: dict[str, Any] = {"mode": switch.mode}
            for name, measured in switch.bounds(arbiter).items():
                row[name] = measured._asdict()
            bounds.append(row)
        return {
            "switches": [asdict(switch) for switch in self.switches],
            "bounds": bounds,
            "outcomes": self.outcomes,
            "exceeded": self.exceeded(arbiter),
            "refusals": [asdict(refusal) for refusal in self.stack.refusals],
            "duration_s": self.stack.plant.time,
            "ended": self.ended,
        }

    def _step(self) -> None:
        stack = self.stack
        switch = self.switches[-1]
        stack.step()
        setpoints = _Setpoints.of(stack)
        steps = setpoints.steps_from(setpoints if self._last is None else self._last)
        self._last = setpoints
        self._measure(switch, steps)
        if self._steps % self._log_every == 0:
            self._log(switch, steps)
        self._steps += 1
        if stack.state == ArbiterState.STOPPED:
            reason = stack.refusals[-1].detail if stack.refusals else "no command came"
            raise SwitchError(
                f"mode '{switch.mode}' lost its turn at {stack.plant.time:.2f} s: {reason}",
            )

    def _log(self, switch: Switch, steps: _Setpoints) -> None:
        stack = self.stack
        self.rows.append(
            {
                "time_s": f"{stack.plant.time:.3f}",
                "mode": switch.mode,
                "active_source": stack.output.active_source or "",
                "state": str(stack.state),
                "controllers": " ".join(stack.manager.active),
                "speed_max_rad_s": f"{np.abs(stack.plant.v).max():.6g}",
                "reference_step_max_rad": f"{steps.reference.max():.6g}",
                "torque_step_max_nm": f"{steps.applied_torque.max():.6g}",
                "torque_step_asked_max_nm": f"{steps.asked_torque.max():.6g}",
            },
        )

    def _measure(self, switch: Switch, steps: _Setpoints) -> None:
        stack = self.stack
        plant = stack.plant
        driven = stack.output.active_source == switch.mode
        if driven and np.isnan(switch.first_command_s):
            switch.first_command_s = plant.time
            switch.first_step_rad = float(np.max(np.abs(stack.output.q_target - plant.q)))
        if plant.time > switch.first_command_s + WINDOW_S:  # false while first_command_s is NaN
            return
        if driven and stack.state in _DRIVEN:
            switch.target_step_rad = _larger(switch.target_step_rad, steps.target)
        reference_ratio = steps.reference / (plant.robot.v_max * plant.dt)
        switch.reference_step_ratio = _larger(switch.reference_step_ratio, reference_ratio)
        switch.torque_step_nm = _larger(switch.torque_step_nm, steps.applied_torque)
        switch.torque_step_asked_nm = _larger(switch.torque_step_asked_nm, steps.asked_torque)


def _larger(so_far: float, steps: Array) -> float:
    return float(np.maximum(so_far, np.max(steps)))
