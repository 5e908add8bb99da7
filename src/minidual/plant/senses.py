"""Sensors of a method beside the arms: poses and forces of objects, pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

import numpy as np

from minidual.config.control import SensingConfig
from minidual.errors import UsageError
from minidual.plant.protocol import ObjectSensors, PoseSample, Reading
from minidual.robot.pair import Array

if TYPE_CHECKING:  # a plant without cameras needs no renderer
    from minidual.plant.render import StampedImage


class Senses(Protocol):
    """Sensors beside those of the arms."""

    def of_object(
        self,
        config: SensingConfig,
        rng: np.random.Generator,
        name: str | None = None,
    ) -> ObjectSensors:
        """Return the sensors of an object, None for the only one.

        Raises:
            UsageError: Nothing senses it.
        """
        ...

    def picture(self, camera: str) -> StampedImage:
        """Return the newest picture of a camera.

        Raises:
            UsageError: There is no camera.
        """
        ...


class _Told:
    """The pose at which a person has put an object; forces are not sensed."""

    delay_ticks = 0

    def __init__(self, T_world_object: Array, clock: _Clock) -> None:
        self._T = T_world_object
        self._clock = clock

    def sense(self) -> Reading:
        """See `ObjectSensors`."""
        no_forces = np.full((2, 3), np.nan)
        return Reading(
            PoseSample(self._T.copy(), 0), no_forces, np.full(2, np.nan), self._clock.time
        )


class _Clock(Protocol):
    @property
    def time(self) -> float: ...


class ToldSenses:
    """Senses of a plant without sensors: a person declares where the objects are.

    Args:
        address: Of the plant, for messages.
        clock: The plant.
        poses: (4, 4) by object.
    """

    def __init__(self, address: str, clock: _Clock, poses: Mapping[str, Array]) -> None:
        self._address = address
        self._clock = clock
        self._poses = poses

    def of_object(
        self,
        config: SensingConfig,
        rng: np.random.Generator,
        name: str | None = None,
    ) -> _Told:
        """See `Senses`."""
        if name is None and len(self._poses) == 1:
            name = next(iter(self._poses))
        if name is None or name not in self._poses:
            raise UsageError(f"nobody has said where '{name}' is, and the plant senses no objects")
        return _Told(self._poses[name], self._clock)

    def picture(self, camera: str) -> StampedImage:
        """See `Senses`."""
        raise UsageError(
            f"plant '{self._address}' brings no camera '{camera}'",
            remedy="use a method that needs no pictures, such as moveit",
        )
