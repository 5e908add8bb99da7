"""The curve of a held object and the arms that hold it, and its time law.

A curve gives 14 joints and the six coordinates of the object over one parameter. The joints are a spline through
solved points; how far the hands stray from their grasps between these points is measured and, where it is too much,
the points are set closer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from minidual.collision.errors import ClosedChainError
from minidual.errors import UsageError
from minidual.motion.hands_ik import HandsIK
from minidual.motion.object_path import ObjectChart
from minidual.motion.timing import MotionLimits, drive, fastest_profile
from minidual.proof.verify import Verification
from minidual.robot.constants import A_MAX, V_MAX, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.trajectory import Trajectory

RESIDUAL_MAX_M = 1e-4
RESIDUAL_MAX_RAD = float(np.deg2rad(0.05))
_STEP_M = 0.01
_POINTS_MIN = 16
_REFINEMENTS = 4
_BETWEEN = (0.25, 0.5, 0.75)
_STILL = 1e-9
_HOPELESS = 0.7


@dataclass(frozen=True)
class ObjectLimits:
    """How fast the object may go: of its centre along the path, and along each axis of the world."""

    speed_m_per_s: float = 0.3
    acceleration_m_per_s2: float = 1.0

    def check(self) -> None:
        """Check both limits.

        Raises:
            UsageError: A limit is not a finite number > 0.
        """
        for name, value in (("speed", self.speed_m_per_s), ("acceleration", self.acceleration_m_per_s2)):
            if not (np.isfinite(value) and value > 0.0):
                raise UsageError(f"the object's {name} limit is {value}; it must be a finite number > 0")


@dataclass(frozen=True, eq=False)
class CarriedTrajectory(Trajectory):
    """A trajectory on which both hands keep their grasps.

    Attributes:
        Ts_world_object: Planned pose of the object at every sample, (n, 4, 4).
        residual_m, residual_rad: Largest error of a hand against its grasp, and of the hands against each other,
            along the path, between the solved points.
        verification: The proof, if a scene was given.
        found_by: How the path was found: "continuation", "object_rrt", "atlas" or "projected".
    """

    Ts_world_object: Array
    residual_m: float
    residual_rad: float
    verification: Verification | None = None
    found_by: str = "continuation"


class HeldCurve:
    """Columns over s: 14 joints, 6 coordinates of the object, and the way of the object (position and turn).

    Args:
        marks: Parameters (n,) of the solved points, first 0.
        Q: Joints at them (n, 14).
        coordinates: Coordinates of the object or a derivative over s: (m,) and order to (m, 6).
        knots: Parameters between which the coordinates are smooth.
    """

    def __init__(self, marks: Array, Q: Array, coordinates: Callable[[Array, int], Array], knots: Array) -> None:
        self.marks = marks
        self.spline = CubicSpline(marks, Q)
        self.coordinates = coordinates
        self.knots = knots

    @property
    def length(self) -> float:
        """End of the parameter interval."""
        return float(self.marks[-1])

    def at(self, s: Array, order: int = 0) -> Array:
        """Return the columns, or their derivative, at (m,) parameters: (m, 21)."""
        s = np.asarray(s, dtype=float)
        return np.column_stack([self.spline(s, order), self.coordinates(s, order), self._way(s, order)])

    def _way(self, s: Array, order: int) -> Array:
        if order == 0:
            return s  # never limited, so its value does not matter
        first = self.coordinates(s, 1)
        speed = np.sqrt(np.sum(first**2, axis=1) + _STILL)
        return speed if order == 1 else np.sum(first * self.coordinates(s, 2), axis=1) / speed


def fine_curve(
    hands: HandsIK,
    chart: ObjectChart,
    length: float,
    knots: Array,
    coordinates: Callable[[Array, int], Array],
    solve: Callable[[Array, Array], Array],
) -> tuple[HeldCurve, float, float]:
    """Return the curve whose hands stray less than allowed, and by how much they stray ([m], [rad]).

    Args:
        hands: Measures.
        chart: Chart of the coordinates.
        length: End of the parameter interval.
        knots: See `HeldCurve`.
        coordinates: See `HeldCurve`.
        solve: Joints (n, 14) for marks (n,) and object poses (n, 4, 4); raises where there are none.

    Raises:
        ClosedChainError: The hands stray too far however close the points are, or `solve` says so.
    """
    count = max(_POINTS_MIN, int(np.ceil(length / _STEP_M)))
    strays = before = (np.inf, np.inf)
    step = length
    for _ in range(_REFINEMENTS):
        marks = np.linspace(0.0, length, count + 1)
        Q = solve(marks, chart.poses(coordinates(marks, 0)))
        curve = HeldCurve(marks, Q, coordinates, knots)
        step = float(marks[1])
        between = np.concatenate([marks[:-1] + share * step for share in _BETWEEN])
        strays = hands.strays(curve.spline(between), chart.poses(coordinates(between, 0)))
        if strays[0] < 0.5 * RESIDUAL_MAX_M and strays[1] < 0.5 * RESIDUAL_MAX_RAD:
            return curve, *strays
        if strays[0] > _HOPELESS * before[0]:
            break  # a smooth motion would stray eight times less with every refinement: this one has a break in it
        before = strays
        count *= 2
    raise ClosedChainError(
        f"the hands stray {strays[0] * 1e3:.3f} mm and {strays[1]:.5f} rad from their grasps between points "
        f"{step * 1e3:.2f} mm apart; allowed are {RESIDUAL_MAX_M * 1e3} mm and {RESIDUAL_MAX_RAD:.5f} rad",
        remedy="the arms pass near a singular posture; choose another path or posture",
    )


def timed(
    curve: HeldCurve, chart: ObjectChart, object_limits: ObjectLimits, scale: MotionLimits, kinematics: Kinematics
) -> tuple[Trajectory, Array]:
    """Return the fastest trajectory within the limits of joints and object, and the object's poses (n, 4, 4).

    Raises:
        TimingError: No time law keeps the limits.
    """
    object_limits.check()
    speed, acceleration = (np.full(7, object_limits.speed_m_per_s), np.full(7, object_limits.acceleration_m_per_s2))
    v_max = np.concatenate([scale.velocity_scale * V_MAX, speed])
    a_max = np.concatenate([scale.acceleration_scale * A_MAX, acceleration])
    s, sd = fastest_profile(curve, np.arange(21), v_max, a_max)
    trajectory, at = drive(curve, s, sd, "both_arms", scale, kinematics)
    return trajectory, chart.poses(curve.coordinates(at, 0))
