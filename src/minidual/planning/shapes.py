"""Simple solid obstacles, given in the world or in the frame of a link.

Sizes are full lengths in metres (a cube of side 0.1 has `size_m` (0.1, 0.1, 0.1)), quaternions are wxyz. The
long axis of a cylinder or capsule is its own z axis; a capsule's `length_m` is that of its cylindrical part.
All are frozen and hashable, so a scene can key the engines built from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from minidual.errors import UsageError
from minidual.robot.constants import Array
from minidual.robot.poses import pose, rotation_from_quat

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]
IDENTITY: Quat = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class _Shape:
    """Name and place shared by all shapes."""

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
            raise UsageError(f"obstacle '{self.name}': quaternion {self.quat_wxyz} is not of length 1")
        for value in self.lengths():
            if value <= 0.0:
                raise UsageError(f"obstacle '{self.name}' has length {value} m; every length must be > 0")

    def lengths(self) -> tuple[float, ...]:
        """Return every length of the shape [m]."""
        raise TypeError(f"{type(self).__name__} is no shape of its own")

    @property
    def T_parent_shape(self) -> Array:
        """Pose (4, 4) in the parent frame: the world for an obstacle, the link for an attached object."""
        return pose(rotation_from_quat(np.array(self.quat_wxyz)), np.array(self.position_m))


@dataclass(frozen=True)
class Box(_Shape):
    """A box with its edges along its own axes."""

    size_m: Vec3 = (0.1, 0.1, 0.1)

    def lengths(self) -> tuple[float, ...]:
        """Return the three edge lengths [m]."""
        return self.size_m


@dataclass(frozen=True)
class Cylinder(_Shape):
    """A cylinder along its own z axis."""

    radius_m: float = 0.05
    length_m: float = 0.1

    def lengths(self) -> tuple[float, ...]:
        """Return radius and length [m]."""
        return (self.radius_m, self.length_m)


@dataclass(frozen=True)
class Capsule(_Shape):
    """A cylinder along its own z axis with a half sphere on each end."""

    radius_m: float = 0.05
    length_m: float = 0.1

    def lengths(self) -> tuple[float, ...]:
        """Return radius and length of the cylindrical part [m]."""
        return (self.radius_m, self.length_m)


@dataclass(frozen=True)
class Sphere(_Shape):
    """A ball."""

    radius_m: float = 0.05

    def lengths(self) -> tuple[float, ...]:
        """Return the radius [m]."""
        return (self.radius_m,)


Shape = Box | Cylinder | Capsule | Sphere


def bounding_radius(shape: Shape) -> float:
    """Return the radius [m] of the smallest ball about the shape's centre that holds it."""
    match shape:
        case Box():
            return 0.5 * math.hypot(*shape.size_m)
        case Cylinder():
            return math.hypot(shape.radius_m, 0.5 * shape.length_m)
        case Capsule():
            return shape.radius_m + 0.5 * shape.length_m
        case Sphere():
            return shape.radius_m
