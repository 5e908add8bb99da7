"""The interface of collision engines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from minidual.collision.shapes import Attached, Shape
from minidual.registry import Registry
from minidual.robot.pair import Array, Robot


class Checked(Protocol):
    """Input of an engine."""

    @property
    def robot(self) -> Robot:
        """The arms."""
        ...

    @property
    def checked_pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs that must not touch."""
        ...

    @property
    def solid_obstacles(self) -> tuple[Shape, ...]:
        """Obstacles in the world."""
        ...

    @property
    def attached(self) -> tuple[Attached, ...]:
        """Objects carried by links."""
        ...


@dataclass(frozen=True)
class Pairs:
    """Chosen pairs, whatever a scene allows."""

    robot: Robot
    checked_pairs: tuple[tuple[str, str], ...]
    solid_obstacles: tuple[Shape, ...] = ()
    attached: tuple[Attached, ...] = ()


@dataclass(frozen=True)
class PairDistance:
    """Two parts and their distance [m], negative in penetration."""

    first: str
    second: str
    distance_m: float

    def __str__(self) -> str:
        kind = "penetrate by" if self.distance_m < 0 else "are apart by"
        return f"{self.first} and {self.second} {kind} {abs(self.distance_m) * 1e3:.1f} mm"


class CollisionEngine(Protocol):
    """Checks one scene. One instance per process."""

    def collisions(self, Q: Array) -> np.ndarray:
        """Return contact (n,) bool for Q (n, dof)."""
        ...


ENGINES: Registry[Callable[[Any], CollisionEngine]] = Registry(
    "collision engine",
    {"mujoco": "minidual.collision.mujoco_engine:MujocoEngine", "coal": "minidual.collision.coal_engine:CoalEngine"},
)
"""An audit asks all."""
