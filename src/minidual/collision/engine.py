"""What a collision engine is: it says of configurations whether anything touches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from minidual.collision.shapes import Attached, Shape
from minidual.registry import Registry
from minidual.robot.pair import Array, Robot


class Checked(Protocol):
    """What an engine is built from: a `PlanningScene`, or `Pairs`."""

    @property
    def robot(self) -> Robot:
        """The arms."""
        ...

    @property
    def checked_pairs(self) -> tuple[tuple[str, str], ...]:
        """The pairs of links, obstacles and attached objects that must not touch."""
        ...

    @property
    def solid_obstacles(self) -> tuple[Shape, ...]:
        """What stands in the world."""
        ...

    @property
    def attached(self) -> tuple[Attached, ...]:
        """What moves with a link."""
        ...


@dataclass(frozen=True)
class Pairs:
    """Chosen pairs of a robot, whatever a scene allows."""

    robot: Robot
    checked_pairs: tuple[tuple[str, str], ...]
    solid_obstacles: tuple[Shape, ...] = ()
    attached: tuple[Attached, ...] = ()


@dataclass(frozen=True)
class PairDistance:
    """Two parts of the scene and the distance between them [m], negative inside each other."""

    first: str
    second: str
    distance_m: float

    def __str__(self) -> str:
        kind = "penetrate by" if self.distance_m < 0 else "are apart by"
        return f"{self.first} and {self.second} {kind} {abs(self.distance_m) * 1e3:.1f} mm"


class CollisionEngine(Protocol):
    """Collision checks of one scene. One instance holds one workspace: give each process its own."""

    def collisions(self, Q: Array) -> np.ndarray:
        """Return for each row of Q (n, dof) whether anything touches, (n,) bool."""
        ...


ENGINES: Registry[Callable[[Any], CollisionEngine]] = Registry(
    "collision engine",
    {"mujoco": "minidual.collision.mujoco_engine:MujocoEngine", "coal": "minidual.collision.coal_engine:CoalEngine"},
)
"""Both are built from one description by different libraries; an audit asks all of them."""
