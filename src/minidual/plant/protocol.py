"""Interface between the control stack and simulated or real arms.

True object poses and contact forces are not part of it.
"""

from typing import NamedTuple, Protocol

from minidual.errors import MinidualError
from minidual.robot.pair import Array, Robot


class PlantEndedError(MinidualError):
    """There is nothing left to drive. After any other error of `command` or `step`, arms stop."""


class Plant(Protocol):
    """Two arms with hands. Measurements are copies, updated in `step`.

    One that takes joint targets instead of torques is a `plant.lifecycle.PositionPlant`; what else
    a plant may say is listed there.
    """

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

    def brake(self, arms: tuple[int, ...]) -> None:
        """Hold exactly these arms by brakes that need no measurements, and release the others."""
        ...

    def step(self) -> None:
        """Advance by `dt`, or wait for the next measurements."""
        ...


def openings_of(plant: Plant) -> Array:
    """Return the measured openings (2,) of the hands, 0 closed to 1 open."""
    return plant.fingers / plant.robot.hand.travel_m


class PoseSample(NamedTuple):
    """A measured pose (4, 4) and its age in control steps."""

    T_world_object: Array
    age_ticks: int


class Reading(NamedTuple):
    """Measurements of an object in one control step.

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
        """Return new readings; to be called once a control step."""
        ...
