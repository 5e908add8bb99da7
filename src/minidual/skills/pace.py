"""Shortest duration of a motion within the limits of joints and object.

Minimum jerk over distance d in time T peaks at speed 1.875 d / T and acceleration 5.7735 d / T^2, so

    T = max( 1.875 d / v_max,  sqrt(5.7735 d / a_max) )

over object position, yaw and all joints; at least 0.25 s.
"""

from __future__ import annotations

import math

import numpy as np

from minidual.config.control import PaceConfig
from minidual.config.scene import SceneConfig
from minidual.control.object_path import Waypoint, minimum_jerk
from minidual.robot.pair import Array, Robot
from minidual.skills.reach import grasp_posture
from minidual.tasks.rod_carry import level_pose

_PEAK_SPEED = 1.875
_PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)
_LEAST_S = 0.25
_SAMPLES = 12


def _time(distance: float | Array, speed: float | Array, acceleration: float | Array) -> float:
    d = np.abs(distance)
    return float(np.max(np.maximum(_PEAK_SPEED * d / speed, np.sqrt(_PEAK_ACCELERATION * d / acceleration))))


def joint_duration_s(q0: Array, q1: Array, pace: PaceConfig, robot: Robot) -> float:
    """Return the time between two postures (n,)."""
    speed, acceleration = pace.joint_speed_share * robot.v_max, pace.joint_acceleration_share * robot.a_max
    return max(_LEAST_S, _time(q1 - q0, speed, acceleration))


def object_duration_s(
    scene: SceneConfig, robot: Robot, start: Waypoint, end: Waypoint, q_near: Array, pace: PaceConfig
) -> tuple[float, Array]:
    """Return the time of a straight held motion, and the end posture; waypoint times are ignored.

    Raises:
        GraspUnreachableError: A hand cannot follow.
    """
    a, b = (np.array([*w.xyz_m, w.yaw_rad]) for w in (start, end))
    postures = [q_near]
    for k in range(_SAMPLES + 1):
        x, y, z, yaw = a + minimum_jerk(k / _SAMPLES)[0] * (b - a)
        postures.append(grasp_posture(scene, robot, level_pose(x, y, z, yaw), postures[-1]))
    q = np.array(postures[1:])
    # Samples are even in time: differences give speeds and accelerations for a duration of 1 s.
    speed = np.abs(np.diff(q, axis=0)) * _SAMPLES / (pace.joint_speed_share * robot.v_max)
    acceleration = np.abs(np.diff(q, 2, axis=0)) * _SAMPLES**2 / (pace.joint_acceleration_share * robot.a_max)
    distance, turn = float(np.linalg.norm(b[:3] - a[:3])), float(abs(b[3] - a[3]))
    return max(
        _LEAST_S,
        _time(distance, pace.object_speed_m_per_s, pace.object_acceleration_m_per_s2),
        _time(turn, pace.object_turn_rad_per_s, pace.object_turn_rad_per_s2),
        float(speed.max()),
        float(np.sqrt(acceleration.max())),
    ), q[-1]
