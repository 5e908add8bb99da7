"""Object paths: straight minimum-jerk segments between poses."""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from minidual.control.object_impedance import ObjectState
from minidual.robot.pair import Array


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
        self._poses = [(*w.xyz_m, w.yaw_rad) for w in points]
        self._ends = list(itertools.accumulate((w.duration_s for w in waypoints), initial=0.0))

    @property
    def duration_s(self) -> float:
        """Total time [s]."""
        return self._ends[-1]

    def at(self, t_s: float) -> ObjectState:
        """See `ObjectMotion`."""
        i = min(max(bisect.bisect_right(self._ends, t_s) - 1, 0), len(self._ends) - 2)
        span = self._ends[i + 1] - self._ends[i]
        blend, rate, curvature = minimum_jerk((t_s - self._ends[i]) / span)
        (x0, y0, z0, yaw0), (x1, y1, z1, yaw1) = self._poses[i], self._poses[i + 1]
        dx, dy, dz, turn = x1 - x0, y1 - y0, z1 - z0, yaw1 - yaw0
        yaw = yaw0 + blend * turn
        c, s, v, a = math.cos(yaw), math.sin(yaw), rate / span, curvature / span**2
        T: Array = np.array(
            [
                [c, -s, 0.0, x0 + blend * dx],
                [s, c, 0.0, y0 + blend * dy],
                [0.0, 0.0, 1.0, z0 + blend * dz],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
        return ObjectState(
            T,
            np.array([v * dx, v * dy, v * dz, 0.0, 0.0, v * turn]),
            np.array([a * dx, a * dy, a * dz, 0.0, 0.0, a * turn]),
        )
