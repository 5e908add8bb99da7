"""A plant whose measurements arrive late, for studies of latency."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from minidual.errors import UsageError
from minidual.plant.protocol import Plant
from minidual.robot.pair import Array, Robot


@dataclass(frozen=True)
class _State:
    stamp_s: float
    q: Array
    v: Array
    tau: Array
    fingers: Array
    grip: Array


class DelayedPlant:
    """Hands on the measurements of another plant after a delay; commands and the clock pass at once.

    Before the delay is over the first measurements are what has arrived: the arms are taken to have been at rest.

    Args:
        plant: The plant behind it.
        delay_s: Age of the measurements [s], rounded to control steps.

    Raises:
        UsageError: The delay is negative.
    """

    def __init__(self, plant: Plant, delay_s: float) -> None:
        if not delay_s >= 0.0:
            raise UsageError(f"delay_s is {delay_s}; it must be at least 0")
        self._plant, self.dt = plant, plant.dt
        self._states: deque[_State] = deque(maxlen=round(delay_s / plant.dt) + 1)
        self.forget()

    def forget(self) -> None:
        """Begin anew; it belongs to every reset of the plant behind it."""
        self._states.clear()
        self._note()

    def _note(self) -> None:
        plant = self._plant
        self._states.append(_State(plant.stamp_s, plant.q, plant.v, plant.tau, plant.fingers, plant.grip))

    @property
    def robot(self) -> Robot:
        """The two arms."""
        return self._plant.robot

    @property
    def time(self) -> float:
        """Time of the control loop [s]."""
        return self._plant.time

    @property
    def stamp_s(self) -> float:
        """When the measurements were taken [s]."""
        return self._states[0].stamp_s

    @property
    def q(self) -> Array:
        """Joint positions (n,) [rad]."""
        return self._states[0].q.copy()

    @property
    def v(self) -> Array:
        """Joint velocities (n,) [rad/s]."""
        return self._states[0].v.copy()

    @property
    def tau(self) -> Array:
        """Torques (n,) [Nm]."""
        return self._states[0].tau.copy()

    @property
    def fingers(self) -> Array:
        """Distance (2,) [m] of each hand's fingers from the middle."""
        return self._states[0].fingers.copy()

    @property
    def grip(self) -> Array:
        """Closing force (2,) [N] of each hand."""
        return self._states[0].grip.copy()

    @property
    def grip_max_n(self) -> float:
        """Largest closing force [N]."""
        return self._plant.grip_max_n

    @property
    def health(self) -> str:
        """Return why the plant cannot be driven, or an empty string."""
        return self._plant.health

    def command(self, tau: Array, fingers: Array) -> None:
        """Set torques (n,) [Nm] and finger targets (2,) [m]."""
        self._plant.command(tau, fingers)

    def step(self) -> None:
        """Advance by one control step."""
        self._plant.step()
        self._note()
