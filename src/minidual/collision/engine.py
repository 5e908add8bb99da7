"""Table of collision engines, and what they take and return."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from minidual.collision.shapes import Attached, Shape
from minidual.registry import Registry
from minidual.robot.pair import Robot


@dataclass(frozen=True)
class Pairs:
    """Pairs of parts; engines take these or a `PlanningScene`."""

    robot: Robot
    checked_pairs: tuple[tuple[str, str], ...]
    solid_obstacles: tuple[Shape, ...] = ()
    attached: tuple[Attached, ...] = ()


@dataclass(frozen=True)
class PairDistance:
    """Two parts; distance negative in penetration."""

    first: str
    second: str
    distance_m: float

    def __str__(self) -> str:
        kind = "penetrate by" if self.distance_m < 0 else "are apart by"
        return f"{self.first} and {self.second} {kind} {abs(self.distance_m) * 1e3:.1f} mm"


ENGINES: Registry[Callable[[Any], Any]] = Registry(
    "collision engine",
    {"mujoco": "minidual.collision.mujoco_engine:MujocoEngine", "coal": "minidual.collision.coal_engine:CoalEngine"},
)
"""Built from a scene; `collisions(Q)` returns contact (n,) bool for Q (n, dof). Audits ask all."""
