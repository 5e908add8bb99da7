"""Interface between the control stack and the arms: measurements, commands and clock.

`World` and `DelayedPlant` implement it; a real robot's driver can. True object poses and contact forces are not part of
it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from minidual.robot.pair import Array, Robot


class Plant(Protocol):
    """Two arms with hands. Measurements are copies and change only in `step`."""

    dt: float
    """Period of the control loop [s]."""

    @property
    def robot(self) -> Robot:
        """The two arms."""
        ...

    @property
    def time(self) -> float:
        """Time of the control loop [s]."""
        ...

    @property
    def stamp_s(self) -> float:
        """Time of the measurements on the same clock [s]; at most `time`."""
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
        """Applied motor torques (n,) [Nm]."""
        ...

    @property
    def fingers(self) -> Array:
        """Distance (2,) [m] of each hand's fingers from the middle."""
        ...

    @property
    def grip(self) -> Array:
        """Closing force (2,) [N] of each hand: mean of its finger motors."""
        ...

    @property
    def grip_max_n(self) -> float:
        """Largest closing force [N]."""
        ...

    @property
    def health(self) -> str:
        """Why the plant cannot be driven; empty if it can."""
        ...

    def command(self, tau: Array, fingers: Array) -> None:
        """Set torques (n,) [Nm] and finger targets (2,) [m] for the next step."""
        ...

    def step(self) -> None:
        """Advance by `dt`, or wait for the next measurements."""
        ...


@dataclass(frozen=True)
class PoseSample:
    """One measured object pose.

    Attributes:
        T_world_object: (4, 4).
        age_ticks: Age in control steps.
    """

    T_world_object: Array
    age_ticks: int


@dataclass(frozen=True)
class Reading:
    """Object measurements that arrived in one control step.

    Attributes:
        pose: None between samples.
        hand_forces: (2, 3) [N], of each hand on the object, world axes.
        pinch: (2,) [N], of each hand.
        stamp_s: Sampling time of forces and pinch [s].
    """

    pose: PoseSample | None
    hand_forces: Array
    pinch: Array
    stamp_s: float


class ObjectSensors(Protocol):
    """Cameras and force sensors of one object."""

    @property
    def delay_ticks(self) -> int:
        """Age of a pose sample on arrival, in control steps."""
        ...

    def sense(self) -> Reading:
        """Return what has arrived; call once a control step."""
        ...
