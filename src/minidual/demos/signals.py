"""Signals that an episode may record beside joints and pictures (`teleop.signals`)."""

from collections.abc import Mapping, Sequence
from enum import StrEnum

import numpy as np

from minidual.config.learning import TeleopConfig
from minidual.control.commands import ArbiterState
from minidual.control.reflexes import REFLEXES
from minidual.control.stack import ControlStack
from minidual.demos.sensed import SENSED, ForceReadings
from minidual.plant.protocol import Plant
from minidual.plant.render import StampedImage
from minidual.robot.pair import Array


class Driver(StrEnum):
    """Drivers of the arms in a tick; the index in this order is recorded."""

    LEADER = "leader"
    POLICY = "policy"
    CORRECTION = "correction"


DRIVERS = tuple(Driver)
ARBITER_STATES = tuple(ArbiterState)
REFLEX_NAMES = ("", *REFLEXES)


def recorded_signals(config: TeleopConfig) -> tuple[str, ...]:
    """Return the signals that episodes hold; with the driver, if a policy is corrected."""
    if config.correct and "driver" not in config.signals:
        return (*config.signals, "driver")
    return config.signals


class Signals:
    """Measures the chosen signals of a tick.

    Args:
        stack: Of the session.
        names: Of `schema.SIGNALS`.
    """

    def __init__(self, stack: ControlStack[Plant], names: Sequence[str]) -> None:
        self._stack = stack
        self._names = tuple(names)
        self._forces = ForceReadings(stack)
        self.reset()

    def reset(self) -> None:
        """Begin an episode."""
        self._stamps_s: dict[str, float] = {}

    def measure(
        self,
        pictures: Mapping[str, StampedImage],
        driver: Driver,
        late_s: float,
    ) -> dict[str, Array]:
        """Return arrays by field of the schema; empty without signals.

        Args:
            pictures: Of this tick.
            driver: Who drives.
            late_s: Wall time by which the tick came late.
        """
        if not self._names:
            return {}
        values = {"signal_timestamps": np.array(self._stack.plant.stamp_s)}
        lost_n = self._count_lost(pictures)
        for name in self._names:
            values[name] = np.asarray(self._value(name, driver, late_s, lost_n), dtype=float)
        return values

    def _value(self, name: str, driver: Driver, late_s: float, lost_n: int) -> Array | float:
        match name:
            case _ if name in SENSED:
                return self._forces.read(name)
            case "arbiter_state":
                return ARBITER_STATES.index(self._stack.state)
            case "reflex":
                reflex = self._stack.reflex
                return 0 if reflex is None else REFLEX_NAMES.index(reflex.reflex.name)
            case "driver":
                return DRIVERS.index(driver)
            case "late_s":
                return late_s
            case _:
                return lost_n

    def _count_lost(self, pictures: Mapping[str, StampedImage]) -> int:
        """Return the number of cameras without a new picture since the last tick."""
        lost_n = 0
        for camera, picture in pictures.items():
            lost_n += picture.stamp_s <= self._stamps_s.get(camera, -np.inf)
            self._stamps_s[camera] = picture.stamp_s
        return lost_n
