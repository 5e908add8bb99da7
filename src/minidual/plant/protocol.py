"""Interface between the control stack and simulated or real arms, without true object poses and contact forces.

`DelayedPlant` is a plant with delayed measurements.
"""

from collections import deque
from copy import copy
from typing import Any, NamedTuple, Protocol

from minidual.errors import UsageError
from minidual.robot.pair import Array, Robot


class Plant(Protocol):
    """Two arms with hands. Measurements are copies, updated in `step`."""

    dt: float
    """Control period [s]."""
    grip_max_n: float
    """Largest closing force [N]."""
    health: str
    """Why the plant cannot be driven, or empty."""

    robot: Robot

    @property
    def time(self) -> float:
        """Control time [s]."""
        ...

    @property
    def stamp_s(self) -> float:
        """Measurement time [s] on that clock; at most `time`."""
        ...

    @property
    def q(self) -> Array:
        """Joint positions (n,) [rad]."""
        ...

    @property
    def v(self) -> Array:
        """Joint velocities (n,) [rad/s]."""
        ...

    @property
    def tau(self) -> Array:
        """Motor torques (n,) [Nm]."""
        ...

    @property
    def fingers(self) -> Array:
        """Finger distances (2,) [m] from the middle."""
        ...

    @property
    def grip(self) -> Array:
        """Closing force (2,) [N], mean of the finger motors."""
        ...

    def command(self, tau: Array, fingers: Array) -> None:
        """Set torques (n,) [Nm] and finger targets (2,) [m]."""
        ...

    def step(self) -> None:
        """Advance by `dt`, or wait for the next measurements."""
        ...


class PoseSample(NamedTuple):
    """A measured pose (4, 4) and its age in control steps."""

    T_world_object: Array
    age_ticks: int


class Reading(NamedTuple):
    """Measurements of one control step.

    Attributes:
        pose: None between samples.
        hand_forces: (2, 3) [N], on the object, world axes.
        pinch: (2,) [N].
        stamp_s: Sampling time of the forces.
    """

    pose: PoseSample | None
    hand_forces: Array
    pinch: Array
    stamp_s: float


class ObjectSensors(Protocol):
    """Sensors of one object."""

    delay_ticks: int
    """Age of an arriving pose, in control steps."""

    def sense(self) -> Reading:
        """Return new readings; once a control step."""
        ...


_MEASURED = ("stamp_s", "q", "v", "tau", "fingers", "grip")


def _late(name: str) -> Any:
    return property(lambda self: copy(self._states[0][name]), doc="See `Plant`.")


def _now(name: str) -> Any:
    return property(lambda self: getattr(self._plant, name), doc="See `Plant`.")


class DelayedPlant:
    """Delays measurements by `delay_s`, rounded to control steps; commands, clock and health are immediate.

    Until then the first measurements are returned.

    Raises:
        UsageError: The delay is negative.
    """

    stamp_s, q, v, tau, fingers, grip = map(_late, _MEASURED)
    robot, time, grip_max_n, health, command = map(_now, ("robot", "time", "grip_max_n", "health", "command"))

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

    def step(self) -> None:
        """See `Plant`."""
        self._plant.step()
        self._note()
