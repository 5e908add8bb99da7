"""A plant with delayed measurements."""

from collections import deque
from typing import Any

from minidual.errors import UsageError
from minidual.plant.protocol import Plant
from minidual.robot.pair import Array

_MEASURED = ("stamp_s", "q", "v", "tau", "fingers", "grip")


def _late(name: str, doc: str) -> Any:
    return property(lambda self: self._states[0][name].copy(), doc=doc)


def _now(name: str) -> Any:
    return property(lambda self: getattr(self._plant, name), doc="See `Plant`.")


class DelayedPlant:
    """Delays measurements by `delay_s`, rounded to control steps; commands, clock and health are immediate.

    Until then the first measurements are returned.

    Raises:
        UsageError: The delay is negative.
    """

    q = _late("q", "Joint positions (n,) [rad].")
    v = _late("v", "Joint velocities (n,) [rad/s].")
    tau = _late("tau", "Torques (n,) [Nm].")
    fingers = _late("fingers", "Distance (2,) [m] of each hand's fingers from the middle.")
    grip = _late("grip", "Closing force (2,) [N] of each hand.")
    stamp_s: Any = property(lambda self: self._states[0]["stamp_s"], doc="See `Plant`.")
    robot, time, grip_max_n, health = map(_now, ("robot", "time", "grip_max_n", "health"))

    def __init__(self, plant: Plant, delay_s: float) -> None:
        if not delay_s >= 0.0:
            raise UsageError(f"delay_s is {delay_s}; it must be at least 0")
        self._plant, self.dt = plant, plant.dt
        self._states: deque[dict[str, Any]] = deque(maxlen=round(delay_s / plant.dt) + 1)
        self.forget()

    def forget(self) -> None:
        """Clear the buffer; call after a reset."""
        self._states.clear()
        self._note()

    def _note(self) -> None:
        self._states.append({name: getattr(self._plant, name) for name in _MEASURED})

    def command(self, tau: Array, fingers: Array) -> None:
        """See `Plant`."""
        self._plant.command(tau, fingers)

    def step(self) -> None:
        """See `Plant`."""
        self._plant.step()
        self._note()
