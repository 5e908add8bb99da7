"""What one may ask of a control stack at any time."""

import numpy as np

from minidual.config.control import SPEED_OVERRIDE_MIN, ArbiterConfig
from minidual.control.arbiter import CommandArbiter
from minidual.control.commands import ArbiterState, Refusal
from minidual.control.controller_manager import ControllerManager
from minidual.control.execution import START_RAD_PER_S
from minidual.control.loop import ControlLoop
from minidual.control.measurement import Measurement
from minidual.control.reflexes import ReflexError
from minidual.errors import UsageError
from minidual.robot.pair import Array


class StackState:
    """State of a stack that consists of a loop and an arbiter.

    Attributes:
        arbiter: Decides who drives.
        refusals: The last of the `refused_n` refusals since the reset.
    """

    _loop: ControlLoop
    _config: ArbiterConfig
    _stop_ticks: int
    _pending: bool
    _countdown: int
    _speed: float
    _due: bool
    arbiter: CommandArbiter
    refusals: list[Refusal]
    refused_n: int

    @property
    def measurement(self) -> Measurement:
        """Of this tick, validated; every part of the loop uses this one."""
        return self._loop.measurement

    @property
    def overruns_n(self) -> int:
        """Ticks since the reset that came more than half a control period late."""
        return self._loop.reader.overruns_n

    def anticipate(self, rate_hz: float) -> None:
        """Feed the velocity of streamed targets of this rate forward; call while the arms rest.

        The arms then lag a leader by little more than a period of the targets.
        """
        self._loop.anticipate(1.0 / rate_hz)

    @property
    def manager(self) -> ControllerManager:
        """The controllers."""
        return self._loop.manager

    @property
    def applied(self) -> Array:
        """Last torques (n,) [Nm] that the plant has taken."""
        return self._loop.applied

    @property
    def reflex(self) -> ReflexError | None:
        """Error of the latched reflex, or None."""
        return self._loop.reflex

    def holds(self, hand: int) -> bool:
        """Return whether a hand has closed on something and feels it."""
        return self._loop.holds(hand)

    def refused_since(self, n: int) -> list[Refusal]:
        """Return what was refused after the first n refusals since the reset."""
        return self.refusals[max(0, n - self.refused_n + len(self.refusals)) :]

    @property
    def source(self) -> str | None:
        """Source that may drive, or None."""
        return self.arbiter.source

    @property
    def state(self) -> ArbiterState:
        """State of the arbiter."""
        return self.arbiter.state

    @property
    def stopping(self) -> bool:
        """Whether a reflex or a halt is bringing the arms to rest, for 2 s at most."""
        still = self._config.still_speed_rad_s
        return self._stop_ticks > 0 and not np.abs(self.measurement.v).max() < still

    @property
    def calm(self) -> bool:
        """Whether no joint moves too fast for a trajectory to start, with a margin."""
        return bool(np.abs(self.measurement.v).max() < 0.8 * START_RAD_PER_S)

    @property
    def executing(self) -> bool:
        """Whether a timed command runs or waits."""
        running = [one for one in self.arbiter.underway.executions if not one.finished]
        return self._pending or bool(running)

    @property
    def tick_next(self) -> bool:
        """Whether the next `step` has a regular arbiter tick."""
        return self._countdown == 0

    @property
    def speed_override(self) -> float:
        """Share of full speed, 0.1 to 1, also in motion.

        Raises:
            UsageError: When set outside its range.
        """
        return self._speed

    @speed_override.setter
    def speed_override(self, share: float) -> None:
        if not SPEED_OVERRIDE_MIN <= share <= 1.0:
            bounds = f"it may be {SPEED_OVERRIDE_MIN} to 1.0"
            raise UsageError(f"a speed override of {share} is refused; {bounds}")
        self._speed = float(share)
        self.arbiter.speed = self._speed
        self._due = True
