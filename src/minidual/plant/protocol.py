"""The seam between the control stack and the arms: what is measured, what is commanded, and the clock.

`World` is the simulated plant, `DelayedPlant` hands on any plant's measurements late. A real robot behind its vendor's
protocol fits as well: its last state packet gives the measurements and their stamp. The true pose of an object and the
true contact forces are no part of a plant: they belong to `World`, for judges and pictures.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from minidual.robot.pair import Array, Robot


class Plant(Protocol):
    """Two arms with their hands. Measurements change in `step` only, and are copies."""

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
        """When the measurements were taken, on the same clock [s]; at most `time`."""
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
        """Torques (n,) [Nm] that the motors apply."""
        ...

    @property
    def fingers(self) -> Array:
        """Distance (2,) [m] of each hand's fingers from the middle between them."""
        ...

    @property
    def grip(self) -> Array:
        """Force (2,) [N] with which the motors of each hand close its fingers, the mean of the two."""
        ...

    @property
    def grip_max_n(self) -> float:
        """Largest such force [N]."""
        ...

    @property
    def health(self) -> str:
        """Return why the plant cannot be driven, or an empty string."""
        ...

    def command(self, tau: Array, fingers: Array) -> None:
        """Set torques (n,) [Nm] and finger targets (2,) [m] for the next step."""
        ...

    def step(self) -> None:
        """Advance by `dt`, or wait for the next measurements."""
        ...


@dataclass(frozen=True)
class PoseSample:
    """One reading of an object's pose.

    Attributes:
        T_world_object: (4, 4) as measured.
        age_ticks: Control steps since it was taken.
    """

    T_world_object: Array
    age_ticks: int


@dataclass(frozen=True)
class Reading:
    """What has arrived of an object at one control step.

    Attributes:
        pose: The pose sample that arrived in this very step, or None between samples.
        hand_forces: (2, 3) [N], of each hand on the object, world axes.
        pinch: (2,) [N], of each hand.
        stamp_s: When forces and pinch were taken [s].
    """

    pose: PoseSample | None
    hand_forces: Array
    pinch: Array
    stamp_s: float


class ObjectSensors(Protocol):
    """Cameras and force sensors that tell of one object."""

    @property
    def delay_ticks(self) -> int:
        """Age of a pose sample when it arrives, in control steps."""
        ...

    def sense(self) -> Reading:
        """Return what has arrived; call once a control step."""
        ...
