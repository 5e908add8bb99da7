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
        self._poses = np.array([(*w.xyz_m, w.yaw_rad) for w in (start, *waypoints)])
        self._ends_s = np.cumsum([0.0, *(w.duration_s for w in waypoints)])

    @property
    def duration_s(self) -> float:
        """Total time [s]."""
        return float(self._ends_s[-1])

    def onward(self, by_m: Array, duration_s: float) -> "ObjectPath":
        """Return a path by_m (3,) from the end of this one."""
        x, y, z, yaw = self._poses[-1].tolist()
        onward = tuple((self._poses[-1, :3] + by_m).tolist())
        return ObjectPath(Waypoint((x, y, z), yaw, 0.0), [Waypoint(onward, yaw, duration_s)])

    def at(self, t_s: float, T_level_object: Array = _LEVEL) -> ObjectState:
        """Return the state at a path time of an object that lies at T_level_object (4, 4) in the level frame."""
        T = np.empty((4, 4))
        motion = np.zeros((2, 6))
        on_path(self._poses, self._ends_s, t_s, T_level_object, T, motion)
        return tuple.__new__(ObjectState, (T, motion[0], motion[1]))
