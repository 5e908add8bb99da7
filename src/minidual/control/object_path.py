"""Where a carried object should be at each instant: straight minimum-jerk segments between poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from minidual.control.object_impedance import ObjectState
from minidual.robot.constants import Array
from minidual.robot.poses import pose, rot_z


def minimum_jerk(s: float) -> tuple[float, float, float]:
    """Return the quintic blend 0..1 at s in 0..1 with its first and second derivative by s (rest to rest)."""
    s = min(1.0, max(0.0, s))
    return (
        s**3 * (10.0 + s * (6.0 * s - 15.0)),
        30.0 * s**2 * (1.0 - s) ** 2,
        60.0 * s * (1.0 + s * (2.0 * s - 3.0)),
    )


@dataclass(frozen=True)
class Waypoint:
    """A level pose of the object and the time to reach it from the one before."""

    xyz_m: tuple[float, float, float]
    yaw_rad: float
    duration_s: float


class ObjectPath:
    """Rest-to-rest motion of an object through level poses.

    Args:
        start: Pose at time zero; its duration is not used.
        waypoints: At least one.
    """

    def __init__(self, start: Waypoint, waypoints: Sequence[Waypoint]) -> None:
        points = [start, *waypoints]
        self._poses = np.array([[*w.xyz_m, w.yaw_rad] for w in points])
        self._ends = np.cumsum([0.0, *(w.duration_s for w in waypoints)])

    @property
    def duration_s(self) -> float:
        """Total time."""
        return float(self._ends[-1])

    def at(self, t_s: float) -> ObjectState:
        """Return pose, twist and acceleration at time t."""
        i = int(np.clip(np.searchsorted(self._ends, t_s, side="right") - 1, 0, len(self._ends) - 2))
        span = self._ends[i + 1] - self._ends[i]
        blend, rate, curvature = minimum_jerk((t_s - self._ends[i]) / span)
        delta = self._poses[i + 1] - self._poses[i]
        x = self._poses[i] + blend * delta
        T: Array = pose(rot_z(float(x[3])), x[:3])
        twist, acceleration = np.zeros(6), np.zeros(6)
        for out, factor in ((twist, rate / span), (acceleration, curvature / span**2)):
            out[:3] = factor * delta[:3]
            out[5] = factor * delta[3]
        return ObjectState(T, twist, acceleration)
