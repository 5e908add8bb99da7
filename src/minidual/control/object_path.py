"""Object paths: straight minimum-jerk segments between poses."""

import bisect
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from minidual.control.kernels import on_line
from minidual.control.object_impedance import ObjectState
from minidual.robot.pair import Array

_LEVEL = np.eye(4)


def minimum_jerk(s: float) -> tuple[float, float, float]:
    """Return the quintic rest-to-rest blend at s, clipped to 0..1, and its first two derivatives."""
    s = min(1.0, max(0.0, s))
    return (s**3 * (10.0 + s * (6.0 * s - 15.0)), 30.0 * s**2 * (1.0 - s) ** 2, 60.0 * s * (1.0 + s * (2.0 * s - 3.0)))


@dataclass(frozen=True)
class Waypoint:
    """Level object pose and the time to reach it from the previous one."""

    xyz_m: tuple[float, float, float]
    yaw_rad: float
    duration_s: float


class ObjectPath:
    """Rest-to-rest object motion through level poses (start's duration unused)."""

    def __init__(self, start: Waypoint, waypoints: Sequence[Waypoint]) -> None:
        points = [start, *waypoints]
        self._poses = np.array([(*w.xyz_m, w.yaw_rad) for w in points])
        self._ends = list(itertools.accumulate((w.duration_s for w in waypoints), initial=0.0))

    @property
    def duration_s(self) -> float:
        """Total time [s]."""
        return self._ends[-1]

    def at(self, t_s: float) -> ObjectState:
        """See `ObjectMotion`."""
        return self.tilted(t_s, _LEVEL)

    def tilted(self, t_s: float, T_level_object: Array) -> ObjectState:
        """Return the state of an object that lies at T_level_object (4, 4) in the level frame."""
        i = min(max(bisect.bisect_right(self._ends, t_s) - 1, 0), len(self._ends) - 2)
        span = self._ends[i + 1] - self._ends[i]
        blend, rate, curvature = minimum_jerk((t_s - self._ends[i]) / span)
        T, motion = np.empty((4, 4)), np.zeros((2, 6))
        on_line(self._poses[i : i + 2], blend, rate / span, curvature / span**2, T_level_object, T, motion)
        return ObjectState(T, motion[0], motion[1])
