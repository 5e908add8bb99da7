"""Limits of commanded poses and twists of a hand; see limits.py."""

import numpy as np

from minidual.plant.franka.limits import DT_S, NOISE, ROUNDING, START_RAD, FciLimits
from minidual.robot.pair import Array

_ROTATION_TOLERANCE = 1e-3
_START_M = 0.01


class CartesianMotion:
    """Checks poses or twists of a hand that come one a millisecond.

    Args:
        limits: Of the arm.
        pose: Where the target stands when the motion starts (4, 4).
        elbow_rad: Third joint when the motion starts.
    """

    _PREFIX = "cartesian_motion_generator"

    def __init__(self, limits: FciLimits, pose: Array, elbow_rad: float = 0.0) -> None:
        self._limits = limits
        self.pose = pose.copy()
        self.twist = np.zeros(6)
        self._a = np.zeros(6)
        self._elbow = np.array([elbow_rad, 0.0, 0.0])
        self._first = True
        self._elbow_first = True

    def target(self, pose: Array) -> list[str]:
        """Take the next pose (4, 4); return the errors."""
        if not is_transformation(pose):
            return ["cartesian_position_motion_generator_invalid_frame"]
        shift = pose[:3, 3] - self.pose[:3, 3]
        turn = rotation_vector(pose[:3, :3] @ self.pose[:3, :3].T)
        far = float(np.linalg.norm(shift)) > _START_M or float(np.linalg.norm(turn)) > START_RAD
        if self._first and far:
            return ["cartesian_position_motion_generator_start_pose_invalid"]
        errors = self._advance(np.r_[shift, turn] / DT_S)
        if not errors:
            self.pose = pose.copy()
        return errors

    def velocity(self, twist: Array) -> list[str]:
        """Take the next twist (6,); return the errors."""
        if not np.isfinite(twist).all():
            return [f"{self._PREFIX}_velocity_limits_violation"]
        errors = self._advance(twist)
        if not errors:
            self.pose[:3, 3] += twist[:3] * DT_S
            self.pose[:3, :3] = rotation(twist[3:] * DT_S) @ self.pose[:3, :3]
        return errors

    def elbow(self, position_rad: float, sign: float, sign_now: float) -> list[str]:
        """Take the next elbow: third joint and sign of the fourth; return the errors."""
        if sign not in (-1.0, 1.0) or (sign_now != 0.0 and sign != sign_now):
            return [f"{self._PREFIX}_elbow_sign_inconsistent"]
        start, v_last, a_last = self._elbow
        if self._elbow_first and abs(position_rad - start) > START_RAD:
            return [f"{self._PREFIX}_start_elbow_invalid"]
        v = (position_rad - start) / DT_S
        a = (v - v_last) / DT_S
        values = (abs(v), abs(a), abs(a - a_last) / DT_S)
        exceeded = [
            value > bound * NOISE for value, bound in zip(values, self._limits.elbow, strict=True)
        ]
        if any(exceeded):
            return [f"{self._PREFIX}_elbow_limit_violation"]
        self._elbow_first = False
        self._elbow[:] = position_rad, v, a
        return []

    def _advance(self, twist: Array) -> list[str]:
        a = (twist - self.twist) / DT_S
        jerk = (a - self._a) / DT_S
        limits = self._limits
        names = (
            "velocity_limits_violation",
            "velocity_discontinuity",
            "acceleration_discontinuity",
        )
        tolerances = (1.0 + ROUNDING, NOISE, NOISE)
        errors: list[str] = []
        for values, name, linear, angular, tolerance in zip(
            (twist, a, jerk),
            names,
            limits.linear,
            limits.angular,
            tolerances,
            strict=True,
        ):
            too_far = float(np.linalg.norm(values[:3])) > linear * tolerance
            too_much = float(np.linalg.norm(values[3:])) > angular * tolerance
            if too_far or too_much:
                errors.append(f"{self._PREFIX}_{name}")
        if not errors:
            self._first = False
            self.twist = twist.copy()
            self._a = a
        return errors


def is_transformation(pose: Array) -> bool:
    """Return whether a matrix (4, 4) is a rotation and a translation."""
    if not np.isfinite(pose).all():
        return False
    R = pose[:3, :3]
    orthogonal = np.abs(R @ R.T - np.eye(3)).max() < _ROTATION_TOLERANCE
    right_handed = abs(float(np.linalg.det(R)) - 1.0) < _ROTATION_TOLERANCE
    last_row = np.abs(pose[3] - (0.0, 0.0, 0.0, 1.0)).max() < 1e-6
    return bool(orthogonal and right_handed and last_row)


def rotation_vector(R: Array) -> Array:
    """Return the rotation vector (3,) of a small rotation (3, 3)."""
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return axis
    angle = float(np.arctan2(sine, 0.5 * (np.trace(R) - 1.0)))
    return axis * (angle / sine)


def rotation(vector: Array) -> Array:
    """Return the rotation (3, 3) of a rotation vector (3,)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-12:
        return np.eye(3) + K
    first = np.sin(angle) / angle
    second = (1.0 - np.cos(angle)) / angle**2
    return np.eye(3) + first * K + second * K @ K
