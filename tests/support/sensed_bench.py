"""A stand-in for a world, for sensors of one object."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from minidual.config.control import SensingConfig
from minidual.plant.sensing import Sensors
from minidual.robot.pair import pose, rot_z


@dataclass
class SensedBench:
    """What sensors may ask of a world, and nothing else."""

    dt: float = 0.001
    time: float = 0.0
    T: np.ndarray = field(default_factory=lambda: pose(rot_z(0.3), (0.5, 0.1, 0.01)))
    felt: np.ndarray = field(
        default_factory=lambda: np.array([[1.0, -40.0, 2.0], [0.0, 40.0, 2.0]]),
    )
    pinches: tuple[float, float] = (60.0, 50.0)

    def truth(self, name: object = None) -> SensedBench:
        return self

    def pose(self) -> np.ndarray:
        return self.T.copy()

    def look(self) -> np.ndarray:
        return np.r_[np.zeros(6), self.felt.ravel(), self.pinches, 0.0]


def sensors(world: Any, rng: int = 0, **changes: float) -> Sensors:
    return Sensors(world, SensingConfig(**changes), np.random.default_rng(rng))
