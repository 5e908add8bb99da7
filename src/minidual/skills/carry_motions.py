"""Grasp postures and motions of a carry, its internal force, and the law's object model.

Motions are as fast as `carry.pace` allows. Minimum jerk over distance d in time T peaks at speed
1.875 d / T and acceleration 5.7735 d / T^2, so

    T = max( 1.875 d / v_max,  sqrt(5.7735 d / a_max) )

over object position, yaw and all joints; at least 0.25 s.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from minidual.config.control import PaceConfig
from minidual.config.scene import SceneConfig
from minidual.control.impedance import SQUEEZE_MAX_N, HeldObject, ObjectState
from minidual.control.impedance_controllers import SLOW_AT, SQUEEZE_RATE_N_PER_S
from minidual.control.kernels import minimum_jerk
from minidual.motion.ik import PoseUnreachableError, posture_at
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot, inverse
from minidual.robot.trajectory import Trajectory
from minidual.skills.object_path import ObjectPath, Waypoint
from minidual.skills.phases import PHASES
from minidual.skills.states import raised
from minidual.tasks.task import Placement, grasp_offsets, level_pose, placement

LANDED_S = 0.1
"""Rest time before release."""
_TESTED = 1.15
"""Share of the squeeze that is tried before the lift: smooth objects slip on the table, not in
the air."""
_PEAK_SPEED = 1.875
_PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)
_LEAST_S = 0.25
_SAMPLES = 12
"""Of a path, for the speeds of the joints."""
_BRANCH_RAD = 2.0
"""A posture that differs more in one joint is on another branch.

The differences are below 1.4 rad on the same branch, and 2.5 rad and more on another.
"""


# Grasps -------------------------------------------------------------------------------------------


def grasp_posture(
    scene: SceneConfig,
    robot: Robot,
    T_level: Array,
    q_near: Array,
    *,
    above_m: float = 0.0,
) -> Array:
    """Return joints (n,) with both hands `above_m` above their grasps.

    Args:
        scene: Of the object.
        robot: Arms.
        T_level: Pose (4, 4) of the level object.
        q_near: Start (n,) of the search: the arms keep their configuration.
        above_m: Height above the grasps.

    Raises:
        PoseUnreachableError: No solution near `q_near`.
    """
    hands = [raised(T_level @ T, above_m) for T in grasp_offsets(scene)]
    return posture_at(robot, hands, q_near)


def posture_over(scene: SceneConfig, robot: Robot, T_world_level: Array, above_m: float) -> Array:
    """Return a posture (n,) with both hands `above_m` above their grasps, reached from home.

    It is `grasp_posture` from home, or the posture nearest to home where the former is near a
    singularity or on another branch.
    """
    left, right = (raised(T_world_level @ T, above_m) for T in grasp_offsets(scene))
    nearest = posture_at(robot, (left, right), robot.home, robot.home)
    with suppress(PoseUnreachableError):
        over = grasp_posture(scene, robot, T_world_level, robot.home, above_m=above_m)
        grasp = grasp_posture(scene, robot, T_world_level, over)
        condition = _worst_condition(robot, (over, grasp))
        if condition < SLOW_AT[0] and np.abs(over - nearest).max() < _BRANCH_RAD:
            return over
    return nearest


def _worst_condition(robot: Robot, postures: tuple[Array, ...]) -> float:
    """Return the largest condition number of a hand's Jacobian at postures (n,)."""
    kinematics = Kinematics(robot)
    jacobians = []
    for q in postures:
        for arm, J in enumerate(kinematics.tcp_jacobians(q)):
            jacobians.append(J[:, robot.joints_of(arm)])
    return np.linalg.cond(jacobians).max()


# Durations and joint motions ----------------------------------------------------------------------


def _time(distance: float | Array, speed: float | Array, acceleration: float | Array) -> float:
    """Return the time [s] of minimum jerk over distances with these limits."""
    d = np.abs(distance)
    by_speed = _PEAK_SPEED * d / speed
    by_acceleration = np.sqrt(_PEAK_ACCELERATION * d / acceleration)
    return float(np.max(np.maximum(by_speed, by_acceleration)))


class HeldLeg(NamedTuple):
    """A straight held motion: its time [s], and the posture (n,) at its end."""

    duration_s: float
    q_end: Array


def object_duration(
    scene: SceneConfig,
    robot: Robot,
    start: Waypoint,
    end: Waypoint,
    q_near: Array,
    pace: PaceConfig,
) -> HeldLeg:
    """Return the time and end of a straight held motion; waypoint times are ignored.

    Raises:
        PoseUnreachableError: A hand cannot follow.
    """
    first = np.array([*start.xyz_m, start.yaw_rad])
    last = np.array([*end.xyz_m, end.yaw_rad])
    q = np.empty((_SAMPLES + 1, robot.dof))
    posture = q_near
    for k in range(_SAMPLES + 1):
        progress, _, _ = minimum_jerk(k / _SAMPLES)
        x, y, z, yaw = first + progress * (last - first)
        posture = grasp_posture(scene, robot, level_pose(x, y, z, yaw), posture)
        q[k] = posture
    # Samples are even in time: differences give speeds and accelerations for a duration of 1 s.
    v_max = pace.joint_speed_share * robot.v_max
    a_max = pace.joint_acceleration_share * robot.a_max
    speed = np.abs(np.diff(q, axis=0)) * _SAMPLES / v_max
    acceleration = np.abs(np.diff(q, 2, axis=0)) * _SAMPLES**2 / a_max
    distance_m = float(np.linalg.norm(last[:3] - first[:3]))
    turn_rad = float(abs(last[3] - first[3]))
    duration_s = max(
        _LEAST_S,
        _time(distance_m, pace.object_speed_m_per_s, pace.object_acceleration_m_per_s2),
        _time(turn_rad, pace.object_turn_rad_per_s, pace.object_turn_rad_per_s2),
        float(speed.max()),
        float(np.sqrt(acceleration.max())),
    )
    return HeldLeg(duration_s, q[-1])


def joint_move(
    q0: Array,
    q1: Array,
    robot: Robot,
    pace: PaceConfig,
    dt_s: float,
    duration_s: float | None = None,
) -> Trajectory:
    """Return a minimum-jerk motion of both arms, by default as fast as `pace` allows."""
    if duration_s is None:
        speed = pace.joint_speed_share * robot.v_max
        acceleration = pace.joint_acceleration_share * robot.a_max
        duration_s = max(_LEAST_S, _time(q1 - q0, speed, acceleration))
    steps = int(np.ceil(duration_s / dt_s))
    profile = np.array([minimum_jerk(k / steps) for k in range(steps + 1)])
    s, ds, dds = profile.T[:, :, None] * (q1 - q0)
    times: Array = np.arange(steps + 1, dtype=float) * dt_s
    return Trajectory(times, q0 + s, ds / times[-1], dds / times[-1] ** 2, "both_arms")


# Held motions -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class HeldMotion:
    """ObjectMotion along level poses, tilted as grasped by `T_level_object`.

    It begins at path time `start_s` and rests beyond the path's ends.
    """

    path: ObjectPath
    T_level_object: Array
    start_s: float
    duration_s: float

    def at(self, t_s: float) -> ObjectState:
        """See `ObjectMotion`."""
        return self.path.at(self.start_s + t_s, self.T_level_object)


class Squeezed(NamedTuple):
    """An object motion, and its internal force [N] by time [s]."""

    motion: HeldMotion
    squeeze_n: Callable[[float], float]


def held_motion(
    phase: str,
    path: ObjectPath,
    T_level_object: Array,
    squeeze_n: float,
) -> Squeezed:
    """Return a phase's object motion and internal force; ramps keep controller C's rate.

    `squeeze` ramps the force up at the path's start, past the request and back; `carry` is the
    path, and a rest; `unload` ramps the force down at the path's end.
    """
    ramp_s = max(PHASES[phase].force_s, squeeze_n / SQUEEZE_RATE_N_PER_S)
    if phase == "squeeze":
        return _tested_squeeze(path, T_level_object, squeeze_n, ramp_s)
    if phase == "carry":
        duration_s = path.duration_s + LANDED_S
        motion = HeldMotion(path, T_level_object, 0.0, duration_s)
        return Squeezed(motion, lambda _: squeeze_n)
    motion = HeldMotion(path, T_level_object, path.duration_s, ramp_s)
    return Squeezed(motion, lambda t_s: squeeze_n * (1.0 - min(1.0, t_s / ramp_s)))


def _tested_squeeze(
    path: ObjectPath,
    T_level_object: Array,
    squeeze_n: float,
    ramp_s: float,
) -> Squeezed:
    """Return a ramp up to a share above 1 of the request, and down to it."""
    most = min(_TESTED, SQUEEZE_MAX_N / max(squeeze_n, 1.0))
    duration_s = (2.0 * most - 1.0) * ramp_s + PHASES["settle"].force_s

    def force_n(t_s: float) -> float:
        rising = t_s / ramp_s
        falling = max(1.0, 2.0 * most - t_s / ramp_s)
        return squeeze_n * min(rising, falling)

    return Squeezed(HeldMotion(path, T_level_object, -duration_s, duration_s), force_n)


def plan_path(
    scene: SceneConfig,
    robot: Robot,
    pace: PaceConfig,
    goal: Placement,
    T_world_object: Array,
    q: Array,
    rest_m: float,
) -> ObjectPath:
    """Return the path up, across and down to the goal, as fast as limits allow.

    Each of the seven comes from somewhere else: scene, arms, settings, trial, estimate, arms'
    state, estimate before the grasp.

    Args:
        scene: Of the object and the task.
        robot: Arms.
        pace: Limits.
        goal: x [m], y [m], yaw [rad].
        T_world_object: Present pose (4, 4).
        q: Present joints (n,).
        rest_m: Sensed height of the object on the table.

    Raises:
        PoseUnreachableError: A hand cannot follow.
    """
    x, y, yaw = placement(T_world_object)
    z = float(T_world_object[2, 3])
    goal_x, goal_y, goal_yaw = goal
    high = z + scene.task.lift_height_m
    landing = rest_m + pace.landing_m
    start = Waypoint((x, y, z), yaw, 0.0)
    untimed = [
        Waypoint((x, y, high), yaw, 0.0),
        Waypoint((goal_x, goal_y, high), goal_yaw, 0.0),
        Waypoint((goal_x, goal_y, landing), goal_yaw, 0.0),
    ]
    waypoints: list[Waypoint] = []
    before = start
    for waypoint in untimed:
        leg = object_duration(scene, robot, before, waypoint, q, pace)
        q = leg.q_end
        waypoints.append(Waypoint(waypoint.xyz_m, waypoint.yaw_rad, leg.duration_s))
        before = waypoint
    if pace.landing_m > 0.0:
        waypoints.append(Waypoint((goal_x, goal_y, rest_m), goal_yaw, pace.landing_s))
    return ObjectPath(start, waypoints)


def held_object(
    scene: SceneConfig,
    T_world_object: Array,
    T_world_tcps: tuple[Array, Array],
) -> HeldObject:
    """Return the law's object model."""
    body = scene.object
    T_object_world = inverse(T_world_object)
    left, right = T_world_tcps
    return HeldObject(
        body.mass_kg,
        np.diag(body.inertia_kg_m2),
        (T_object_world @ left, T_object_world @ right),
        np.array([0.0, 1.0, 0.0]),
    )
