"""Object paths: straight minimum-jerk segments between level poses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from minidual.control.impedance import ObjectState
from minidual.robot.pair import Array
from minidual.skills.object_kernels import on_path

_LEVEL = np.eye(4)


@dataclass(frozen=True)
class Waypoint:
    """Level object pose and the time to reach it from the previous one."""

    xyz_m: tuple[float, float, float]
    yaw_rad: float
    duration_s: float


class ObjectPath:
    """Rest-to-rest object motion through level poses (start's duration unused)."""

    def __init__(self, start: Waypoint, waypoints: Sequence[Waypoint]) -> None:
        self._poses = np.array([(*point.xyz_m, point.yaw_rad) for point in (start, *waypoints)])
        durations_s = [point.duration_s for point in waypoints]
        self._ends_s = np.cumsum([0.0, *durations_s])

    @property
    def duration_s(self) -> float:
        """Total time [s]."""
        return float(self._ends_s[-1])

    def onward(self, by_m: Array, duration_s: float) -> "ObjectPath":
        """Return a path by_m (3,) from the end of this one."""
        x, y, z, yaw = self._poses[-1].tolist()
        next_x, next_y, next_z = (self._poses[-1, :3] + by_m).tolist()
        start = Waypoint((x, y, z), yaw, 0.0)
        return ObjectPath(start, [Waypoint((next_x, next_y, next_z), yaw, duration_s)])

    def at(self, t_s: float, T_level_object: Array = _LEVEL) -> ObjectState:
        """Return the state at a path time; the object is at T_level_object (4, 4) in the level frame."""
        T = np.empty((4, 4))
        motion = np.zeros((2, 6))
        on_path(self._poses, self._ends_s, t_s, T_level_object, T, motion)
        return tuple.__new__(ObjectState, (T, motion[0], motion[1]))
