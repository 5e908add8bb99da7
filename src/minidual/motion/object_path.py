"""The path of a carried object: poses in between, corners rounded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from minidual.errors import UsageError
from minidual.motion.blend import rounded
from minidual.motion.ik import check_pose
from minidual.robot.constants import Array

ROTATION_WEIGHT_M = 0.2
"""How much of path length one radian of rotation counts for [m/rad]."""
_SAME = 1e-6
_ANGLE_MAX_RAD = 3.0


class ObjectChart:
    """Six coordinates [m] of object poses: position, and the rotation vector from a reference by its weight.

    Args:
        R_world_reference: Rotation (3, 3) whose rotation vector is zero.
    """

    def __init__(self, R_world_reference: Array) -> None:
        self._R0 = np.array(R_world_reference)

    def coordinates(self, T: Array) -> Array:
        """Return the coordinates (6,) of a pose (4, 4).

        Raises:
            UsageError: The pose is turned by more than 3 rad from the reference.
        """
        turn = pin.log3(self._R0.T @ T[:3, :3])
        if np.linalg.norm(turn) > _ANGLE_MAX_RAD:
            raise UsageError(
                f"a waypoint turns the object by {np.linalg.norm(turn):.2f} rad from the first; "
                f"at most {_ANGLE_MAX_RAD} rad are supported"
            )
        return np.concatenate([T[:3, 3], ROTATION_WEIGHT_M * turn])

    def pose(self, x: Array) -> Array:
        """Return the pose (4, 4) of coordinates (6,)."""
        T = np.eye(4)
        T[:3, :3] = self._R0 @ pin.exp3(x[3:] / ROTATION_WEIGHT_M)
        T[:3, 3] = x[:3]
        return T

    def poses(self, X: Array) -> Array:
        """Return the poses (n, 4, 4) of coordinates (n, 6)."""
        Ts = np.zeros((len(X), 4, 4))
        Ts[:, 3, 3] = 1.0
        Ts[:, :3, 3] = X[:, :3]
        Ts[:, :3, :3] = self._R0 @ np.array([pin.exp3(x) for x in X[:, 3:] / ROTATION_WEIGHT_M])
        return Ts


class ObjectPath:
    """A smooth curve T_world_object(s), s in [0, length] [m].

    Positions run along straight lines and orientations along straight lines of the rotation vector from the first
    pose (a constant turn about one axis if only the last pose differs); corners are rounded within `corner_m`.

    Args:
        Ts_world_object: Two or more poses (4, 4); neighbours that are equal count once.
        corner_m: Largest half length of a rounded corner.

    Raises:
        UsageError: Fewer than two different poses, a value that is none, or a turn of more than 3 rad.
    """

    def __init__(self, Ts_world_object: Sequence[Array], corner_m: float = 0.04) -> None:
        poses = [check_pose(T, f"waypoint {i} of the object") for i, T in enumerate(Ts_world_object)]
        if len(poses) < 2:
            raise UsageError(f"an object path needs two or more waypoints; there are {len(poses)}")
        self.chart = ObjectChart(poses[0][:3, :3])
        points = [self.chart.coordinates(T) for T in poses]
        kept = [points[0]]
        for point in points[1:]:
            if np.abs(point - kept[-1]).max() > _SAME:
                kept.append(point)
        if len(kept) < 2:
            raise UsageError("all waypoints of the object are the same pose; there is nothing to carry")
        self._curve = rounded(np.array(kept), corner_m)

    @property
    def length(self) -> float:
        """Length of the path, rotation counted by its weight [m]."""
        return self._curve.length

    @property
    def knots(self) -> Array:
        """Parameters where straight pieces and corners meet."""
        return self._curve.knots

    def coordinates(self, s: Array, order: int = 0) -> Array:
        """Return position and weighted rotation vector, or a derivative by s, at (n,) parameters: (n, 6) [m]."""
        return self._curve.at(s, order)

    def pose(self, s: float) -> Array:
        """Return T_world_object (4, 4) at s."""
        return self.poses(np.array([s]))[0]

    def poses(self, s: Array) -> Array:
        """Return Ts_world_object (n, 4, 4) at (n,) parameters."""
        return self.chart.poses(self.coordinates(s))
