"""Waypoints of two hands that take a cube, bring it to the middle, and pass it on."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

type Array = npt.NDArray[np.float64]

_EXCHANGE_M = np.array([0.0, 0.5, 0.27])
_DOWNWARDS = np.deg2rad(60.0)
"""Pitch of the right hand: so steep that its palm stays clear of the table and of the left hand."""
_ABOVE_M = 0.10
_BESIDE_M = 0.12
_DEEP_M = 0.01
"""How far beyond the cube's middle the finger tips of the right hand go."""


class Waypoint(NamedTuple):
    """Where a hand shall be at a time.

    Attributes:
        at_s: Time in the episode [s].
        tip_m: Of the point between the finger tips (3,), world frame [m].
        R: Of the hand (3, 3): x ahead, y along the opening.
        opening: 0 closed, 1 open.
    """

    at_s: float
    tip_m: Array
    R: Array
    opening: float


def hand(ahead: Array, across: Array) -> Array:
    """Return the rotation (3, 3) of a hand that points ahead and opens across."""
    x = ahead / np.linalg.norm(ahead)
    y = across - x * float(x @ across)
    y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def waypoint_at(way: list[Waypoint], time_s: float) -> Waypoint:
    """Return the interpolated waypoint; hands start and stop smoothly."""
    if time_s <= way[0].at_s:
        return way[0]
    for before, after in pairwise(way):
        if time_s < after.at_s:
            share = (time_s - before.at_s) / (after.at_s - before.at_s)
            smooth = share * share * (3.0 - 2.0 * share)
            tip_m = before.tip_m + smooth * (after.tip_m - before.tip_m)
            opening = before.opening + share * (after.opening - before.opening)
            return Waypoint(time_s, tip_m, between(before.R, after.R, smooth), opening)
    return way[-1]


def between(R_from: Array, R_to: Array, share: float) -> Array:
    """Return the rotation a share of the way from one to another, about one axis."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(R_from.T @ R_to).ravel())
    turn = np.empty(3)
    mujoco.mju_quat2Vel(turn, quaternion, 1.0)
    angle = float(np.linalg.norm(turn))
    if angle < 1e-9:
        return R_to
    mujoco.mju_axisAngle2Quat(quaternion, turn / angle, share * angle)
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, quaternion)
    return R_from @ R.reshape(3, 3)


def turn_between(R_from: Array, R_to: Array) -> Array:
    """Return the rotation vector (3,), in the world, that turns one hand into another."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(R_to @ R_from.T).ravel())
    turn = np.empty(3)
    mujoco.mju_quat2Vel(turn, quaternion, 1.0)
    return turn


def ways(cube_m: Array, start: list[tuple[Array, Array]]) -> list[list[Waypoint]]:
    """Return the waypoints of the left and of the right hand."""
    above_m = np.array([0.0, 0.0, _ABOVE_M])
    down = np.array([-np.cos(_DOWNWARDS), 0.0, -np.sin(_DOWNWARDS)])
    right = hand(down, np.array([0.0, -1.0, 0.0]))
    left = hand(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    grasp_m = cube_m + _DEEP_M * down
    beside_m = _EXCHANGE_M - np.array([_BESIDE_M, 0.0, 0.0])
    (left_m, R_left), (right_m, R_right) = start
    right_way = [
        Waypoint(0.0, right_m, R_right, 1.0),
        Waypoint(1.2, grasp_m + above_m, right, 1.0),
        Waypoint(1.9, grasp_m, right, 1.0),
        Waypoint(2.3, grasp_m, right, 0.0),
        Waypoint(3.6, _EXCHANGE_M + _DEEP_M * down, right, 0.0),
        Waypoint(6.0, _EXCHANGE_M + _DEEP_M * down, right, 0.0),
    ]
    left_way = [
        Waypoint(0.0, left_m, R_left, 1.0),
        Waypoint(1.6, left_m, R_left, 1.0),
        Waypoint(3.4, beside_m, left, 1.0),
        Waypoint(4.2, _EXCHANGE_M, left, 1.0),
        Waypoint(4.6, _EXCHANGE_M, left, 0.0),
        Waypoint(6.0, _EXCHANGE_M, left, 0.0),
    ]
    return [left_way, right_way]
