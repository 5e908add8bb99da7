"""Poses (4, 4) and rotations (3, 3)."""

import math

import numpy as np

from minidual.robot.pair import Array


def pose(rotation: Array, position: Array | tuple[float, float, float]) -> Array:
    """Return a pose."""
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = position
    return T


def inverse(T: Array) -> Array:
    """Invert a pose."""
    R = T[:3, :3]
    return pose(R.T, -R.T @ T[:3, 3])


def rot_x(angle_rad: float) -> Array:
    """Rotate about x."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rot_z(angle_rad: float) -> Array:
    """Rotate about z."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_log(R: Array) -> Array:
    """Return the rotation vector (3,) [rad].

    Near pi the axis comes from the symmetric part; the antisymmetric one loses digits.
    """
    vee = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    sine = 0.5 * math.sqrt(vee @ vee)
    angle = math.atan2(sine, cosine)
    if angle < 1e-6:
        return 0.5 * vee
    if angle > math.pi - 1e-4:
        outer = (0.5 * (R + R.T) - cosine * np.eye(3)) / (1.0 - cosine)  # axis axis^T
        column = int(np.argmax(np.diag(outer)))
        axis = outer[:, column] / np.linalg.norm(outer[:, column])
        sign = 1.0 if float(vee @ axis) >= 0.0 else -1.0
        return sign * angle * axis
    return vee * (0.5 * angle / sine)


def rotation_from_quat(quat_wxyz: Array) -> Array:
    """Return the rotation."""
    w, x, y, z = quat_wxyz  # not Pinocchio: a command that asks for tasks need not import it
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
