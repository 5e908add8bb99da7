"""Path, joints and timing of a held object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from minidual.collision.errors import ClosedChainError
from minidual.config.planning import MotionLimits
from minidual.errors import UsageError
from minidual.motion.blend import SmoothPath, rounded
from minidual.motion.checks import check_pose
from minidual.motion.held.hands import RESIDUAL_MAX_M, RESIDUAL_MAX_RAD, HandsIK
from minidual.motion.timing import PathLimits, time_path
from minidual.proof.scene_engines import Verification
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.robot.trajectory import Trajectory

ROTATION_WEIGHT_M = 0.2
"""Path length per radian of rotation [m/rad]."""
_SAME = 1e-6
_ANGLE_MAX_RAD = 3.0
_STEP_M = 0.01
_POINTS_MIN = 16
_REFINEMENTS = 4
_BETWEEN = (0.25, 0.5, 0.75)
_STILL = 1e-9
_HOPELESS = 0.7


class ObjectChart:
    """Object poses as position and weighted rotation vector [m].

    The rotation is from a reference orientation (3, 3).
    """

    def __init__(self, R_world_reference: Array) -> None:
        self._R0 = np.array(R_world_reference)

    def coordinates(self, T: Array) -> Array:
        """Return the coordinates (6,) of a pose (4, 4).

        Raises:
            UsageError: Rotation over 3 rad.
        """
        turn = pin.log3(self._R0.T @ T[:3, :3])
        angle = np.linalg.norm(turn)
        if angle > _ANGLE_MAX_RAD:
            raise UsageError(
                f"a waypoint turns the object by {angle:.2f} rad from the first; at most"
                f" {_ANGLE_MAX_RAD} rad are supported",
            )
        return np.concatenate([T[:3, 3], ROTATION_WEIGHT_M * turn])

    def pose(self, x: Array) -> Array:
        """Return the pose of (6,)."""
        return self.poses(x[None])[0]

    def poses(self, X: Array) -> Array:
        """Return poses (m, 4, 4) of (m, 6)."""
        turns = np.array([pin.exp3(w) for w in X[:, 3:] / ROTATION_WEIGHT_M])
        Ts = np.zeros((len(X), 4, 4))
        Ts[:, 3, 3] = 1.0
        Ts[:, :3, 3] = X[:, :3]
        Ts[:, :3, :3] = self._R0 @ turns
        return Ts


class HeldPath:
    """T_world_object(s), s in [0, length] [m].

    The first six columns of `curve` are chart coordinates.
    """

    def __init__(self, chart: ObjectChart, curve: SmoothPath) -> None:
        self.chart = chart
        self.curve = curve
        self.length = curve.length

    @classmethod
    def through(cls, Ts_world_object: Sequence[Array], corner_m: float = 0.04) -> HeldPath:
        """Return the path through poses (4, 4), straight in the chart, with rounded corners.

        Raises:
            UsageError: Fewer than two distinct poses, invalid pose, or rotation over 3 rad.
        """
        poses = [
            check_pose(T, f"waypoint {i} of the object") for i, T in enumerate(Ts_world_object)
        ]
        if len(poses) < 2:
            raise UsageError(f"an object path needs two or more waypoints; there are {len(poses)}")
        chart = ObjectChart(poses[0][:3, :3])
        distinct: list[Array] = []
        for point in map(chart.coordinates, poses):
            if not distinct or np.abs(point - distinct[-1]).max() > _SAME:
                distinct.append(point)
        if len(distinct) < 2:
            raise UsageError(
                "all waypoints of the object are the same pose; there is nothing to carry",
            )
        return cls(chart, rounded(np.array(distinct), corner_m))

    def coordinates(self, s: Array, order: int = 0) -> Array:
        """Return coordinates (m, 6) [m] or a derivative."""
        return self.curve.at(s, order)[:, :6]

    def poses(self, s: Array) -> Array:
        """Return poses (m, 4, 4)."""
        return self.chart.poses(self.coordinates(s))


@dataclass(frozen=True, eq=False)
class CarriedTrajectory(Trajectory):
    """Trajectory that keeps both grasps.

    Attributes:
        Ts_world_object: Planned poses (m, 4, 4).
        residual_m, residual_rad: Largest error of grasps or between hands.
        found_by: A search method, "continuation" or "given".
    """

    Ts_world_object: Array
    residual_m: float
    residual_rad: float
    verification: Verification | None = None
    found_by: str = "continuation"


class HeldCurve:
    """Columns over s: joints, 6 object coordinates, path length.

    Joints `Q` (k, n) are solved at `marks` (k,), first 0.
    """

    def __init__(self, path: HeldPath, marks: Array, Q: Array) -> None:
        self.path = path
        self.marks = marks
        self.knots = path.curve.knots
        self.spline = CubicSpline(marks, Q)
        self.length = float(marks[-1])
        self.residual = (np.inf, np.inf)
        """Largest error between solved points ([m], [rad])."""

    def at(self, s: Array, order: int = 0) -> Array:
        """Return the columns or a derivative, (m, n + 7)."""
        s = np.asarray(s, dtype=float)
        joints = self.spline(s, order)
        coordinates = self.path.coordinates(s, order)
        return np.column_stack([joints, coordinates, self._way(s, order)])

    def _way(self, s: Array, order: int) -> Array:
        """Return the path length of the object (m,) or a derivative."""
        if order == 0:
            return s  # unused: only derivatives are limited
        first = self.path.coordinates(s, 1)
        speed = np.sqrt(np.sum(first**2, axis=1) + _STILL)
        if order == 1:
            return speed
        return np.sum(first * self.path.coordinates(s, 2), axis=1) / speed

    def timed(
        self,
        along: PathLimits,
        limits: MotionLimits,
        kinematics: Kinematics,
        found_by: str,
    ) -> CarriedTrajectory:
        """Return the fastest trajectory within the limits, unproven.

        Raises:
            TimingError: The limits cannot be kept.
        """
        timed = time_path(self, "both_arms", limits, kinematics, along)
        motion = timed.trajectory
        residual_m, residual_rad = self.residual
        return CarriedTrajectory(
            times=motion.times,
            q=motion.q,
            v=motion.v,
            a=motion.a,
            group=motion.group,
            Ts_world_object=self.path.poses(timed.s),
            residual_m=residual_m,
            residual_rad=residual_rad,
            found_by=found_by,
        )


def fine_curve(hands: HandsIK, path: HeldPath, solve: Callable[[Array, Array], Array]) -> HeldCurve:
    """Return a spline through solved points, refined until errors between them are half the limits.

    `solve` maps marks (k,) and object poses to joints (k, n).

    Raises:
        ClosedChainError: It fails.
    """
    count = max(_POINTS_MIN, int(np.ceil(path.length / _STEP_M)))
    step = path.length
    off_m = off_rad = np.inf
    previous_off_m = np.inf
    for _ in range(_REFINEMENTS):
        marks = np.linspace(0.0, path.length, count + 1, dtype=np.float64)
        curve = HeldCurve(path, marks, solve(marks, path.poses(marks)))
        step = float(marks[1])
        between = np.concatenate([marks[:-1] + share * step for share in _BETWEEN])
        off_m, off_rad = hands.strays(curve.spline(between), path.poses(between))
        curve.residual = (off_m, off_rad)
        if off_m < 0.5 * RESIDUAL_MAX_M and off_rad < 0.5 * RESIDUAL_MAX_RAD:
            return curve
        if off_m > _HOPELESS * previous_off_m:
            # A smooth motion gains a factor of eight per refinement; this one is discontinuous.
            break
        previous_off_m = off_m
        count *= 2
    raise ClosedChainError(
        f"the hands stray {off_m * 1e3:.3f} mm and {off_rad:.5f} rad from their grasps between"
        f" points {step * 1e3:.2f} mm apart; allowed are {RESIDUAL_MAX_M * 1e3} mm and"
        f" {RESIDUAL_MAX_RAD:.5f} rad",
        remedy="the arms pass near a singular posture; choose another path or posture",
    )
