"""Places in scene and goal files."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from pydantic import model_validator

from minidual.collision.shapes import Quat
from minidual.config.base import Coordinate, StrictModel

Finite3 = tuple[Coordinate, Coordinate, Coordinate]
_LENGTH_TOLERANCE = 1e-3


class PlaceFields(StrictModel):
    """A position with optional orientation, in one of two forms."""

    position_m: Finite3
    quat_wxyz: tuple[float, float, float, float] | None = None
    """Scalar first; normalised if its length is within 0.001 of 1."""
    rpy_rad: Finite3 | None = None
    """About fixed x, y, z in this order, as in a URDF."""

    @model_validator(mode="after")
    def _one_way(self) -> PlaceFields:
        if self.quat_wxyz is not None:
            if self.rpy_rad is not None:
                raise ValueError("quat_wxyz and rpy_rad are two ways to say one thing; give one of them")
            length = math.hypot(*self.quat_wxyz)
            if abs(length - 1.0) > _LENGTH_TOLERANCE:
                raise ValueError(f"quat_wxyz has length {length:.4f}; a rotation has 1 (scalar first: w, x, y, z)")
        return self

    def quaternion(self) -> Quat | None:
        """Return the unit quaternion, or None."""
        if self.quat_wxyz is not None:
            length = math.hypot(*self.quat_wxyz)
            w, x, y, z = (v / length for v in self.quat_wxyz)
            return (w, x, y, z)
        if self.rpy_rad is not None:
            quat = pin.Quaternion(pin.rpy.rpyToMatrix(np.array(self.rpy_rad))).normalized()
            return (float(quat.w), float(quat.x), float(quat.y), float(quat.z))
        return None
