"""Immutable solid obstacles.

Sizes are full lengths [m], quaternions wxyz. Cylinders and capsules lie along z; `length_m` excludes a capsule's ends.

`ENGINES` is the table of collision engines.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from minidual.errors import UsageError
from minidual.registry import Registry
from minidual.robot.pair import Array, Robot, pose

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]
IDENTITY: Quat = (1.0, 0.0, 0.0, 0.0)
LENGTH_MIN_M = 1e-4  # MuJoCo compiles no smaller obstacle
_FLAT = 1e-6


@dataclass(frozen=True)
class _Shape:
    name: str
    position_m: Vec3
    quat_wxyz: Quat = IDENTITY

    def __post_init__(self) -> None:
        if not self.name:
            raise UsageError("an obstacle needs a name")
        numbers = (*self.position_m, *self.quat_wxyz, *self.lengths())
        if not all(math.isfinite(v) for v in numbers):
            raise UsageError(f"obstacle '{self.name}' has a number that is not finite: {numbers}")
        if abs(math.fsum(v * v for v in self.quat_wxyz) - 1.0) > 1e-6:
            raise UsageError(
                f"obstacle '{self.name}': quaternion {self.quat_wxyz} is not of length 1",
            )
        shortest = min(self.lengths())
        if shortest < LENGTH_MIN_M:
            raise UsageError(
                f"obstacle '{self.name}' has length {shortest} m; every length must be"
                f" {LENGTH_MIN_M} or more",
            )

    def lengths(self) -> list[float]:
        """Return all lengths [m]."""
        fields = [getattr(self, name, ()) for name in ("size_m", "radius_m", "length_m")]
        return np.hstack(fields).tolist()

    @property
    def T_parent_shape(self) -> Array:
        """Pose (4, 4) in the world, or the link that holds it."""
        rotation = pin.Quaternion(*self.quat_wxyz).normalized().matrix()
        return pose(rotation, self.position_m)


@dataclass(frozen=True)
class Box(_Shape):
    """A box along its axes."""

    size_m: Vec3 = (0.1, 0.1, 0.1)


@dataclass(frozen=True)
class _Round(_Shape):
    radius_m: float = 0.05
    length_m: float = 0.1


class Cylinder(_Round):
    """A cylinder along z."""


class Capsule(_Round):
    """A cylinder with half-sphere ends."""


@dataclass(frozen=True)
class Sphere(_Shape):
    """A ball."""

    radius_m: float = 0.05


@dataclass(frozen=True)
class Mesh(_Shape):
    """A union of convex pieces.

    Attributes:
        pieces: Vertices of each piece, (n, 3) float64 [m], as hashable bytes.
        file: Source, for messages.
    """

    pieces: tuple[bytes, ...] = ()
    file: str = ""

    def __post_init__(self) -> None:
        if not self.pieces:
            raise UsageError(f"obstacle '{self.name}': a mesh needs at least one convex piece")
        if not all(_solid(vertices) for vertices in self.vertices()):
            raise UsageError(
                f"obstacle '{self.name}': a piece of its mesh is no solid of finite vertices",
            )
        super().__post_init__()

    def lengths(self) -> list[float]:
        """Return the bounding box's edges [m]."""
        return np.ptp(np.vstack(self.vertices()), axis=0).tolist()

    def vertices(self) -> tuple[Array, ...]:
        """Return each piece's vertices (n, 3) [m], in the shape's frame."""
        return tuple(np.frombuffer(piece, dtype=float).reshape(-1, 3) for piece in self.pieces)


def _solid(vertices: Array) -> bool:
    """Return whether vertices (n, 3) span a volume; without one, hull libraries end the process."""
    if len(vertices) < 4 or not np.isfinite(vertices).all():
        return False
    thickness = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)[2]
    return bool(thickness >= _FLAT * np.ptp(vertices, axis=0).max())


Shape = Box | Cylinder | Capsule | Sphere | Mesh


class Attached(NamedTuple):
    """An object moving with `link`; `touch_links` may touch it."""

    shape: Shape
    link: str
    touch_links: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the shape."""
        return self.shape.name


def grown(shape: Shape, by_m: float) -> Shape:
    """Return a shape containing everything within `by_m`.

    Spheres and capsules are exact; others keep sharp edges, up to 0.73 by_m farther.
    """
    if by_m <= 0.0:
        return shape
    match shape:
        case Box():
            x, y, z = shape.size_m
            return replace(shape, size_m=(x + 2 * by_m, y + 2 * by_m, z + 2 * by_m))
        case Cylinder():
            return replace(
                shape,
                radius_m=shape.radius_m + by_m,
                length_m=shape.length_m + 2 * by_m,
            )
        case Capsule() | Sphere():
            return replace(shape, radius_m=shape.radius_m + by_m)
        case Mesh():
            # Minkowski sum with a cube that contains the ball: every vertex moves to the cube's
            # eight corners.
            side = [-1.0, 1.0]
            corners = by_m * np.array(np.meshgrid(side, side, side)).reshape(3, -1).T
            pieces = [(vertices[:, None] + corners).reshape(-1, 3) for vertices in shape.vertices()]
            return replace(shape, pieces=tuple(piece.tobytes() for piece in pieces))


class Pairs(NamedTuple):
    """Pairs of parts; engines take these or a `PlanningScene`."""

    robot: Robot
    checked_pairs: tuple[tuple[str, str], ...]
    solids: tuple[Attached, ...] = ()


class PairDistance(NamedTuple):
    """Two parts; distance negative in penetration."""

    first: str
    second: str
    distance_m: float

    def __str__(self) -> str:
        kind = "penetrate by" if self.distance_m < 0 else "are apart by"
        return f"{self.first} and {self.second} {kind} {abs(self.distance_m) * 1e3:.1f} mm"


ENGINES: Registry[Callable[[Any], Any]] = Registry(
    "collision engine",
    {
        "mujoco": "minidual.collision.engines:MujocoEngine",
        "coal": "minidual.collision.engines:CoalEngine",
    },
)
"""Built from a scene; `collisions(Q)` returns contact (n,) bool for Q (n, dof). Audits ask all."""
