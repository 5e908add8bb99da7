"""Grasp postures and motions of a carry, as fast as `carry.pace` allows, its internal force, and the object model of controller C.

Minimum jerk over distance d in time T peaks at speed 1.875 d / T and acceleration 5.7735 d / T^2, so

    T = max( 1.875 d / v_max,  sqrt(5.7735 d / a_max) )

over object position, yaw and all joints; at least 0.25 s.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from minidual.config.control import PaceConfig
from minidual.config.scene import SceneConfig
from minidual.control.impedance import SQUEEZE_MAX_N, HeldObject, ObjectState
from minidual.control.impedance_controllers import SLOW_AT, SQUEEZE_RATE_N_PER_S
from minidual.control.kernels import minimum_jerk
from minidual.control.object_path import ObjectPath, Waypoint
from minidual.motion.ik import PoseUnreachableError, posture_at
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot, inverse
from minidual.robot.trajectory import Trajectory
from minidual.skills.phases import PHASES, raised
from minidual.tasks.task import Placement, grasp_offsets, level_pose, placement

LANDED_S = 0.1
"""Rest time before release."""
_TESTED = 1.15  # share of the squeeze that is tried before the lift: what is smooth slips on the table, not in the air
_PEAK_SPEED = 1.875
_PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)
_LEAST_S = 0.25
_SAMPLES = 12
_BRANCH_RAD = 2.0  # a posture that differs more in one joint is on another branch: below 1.4 on the same, 2.5 beyond


def _time(distance: float | Array, speed: float | Array, acceleration: float | Array) -> float:
    d = np.abs(distance)
    return float(
        np.max(np.maximum(_PEAK_SPEED * d / speed, np.sqrt(_PEAK_ACCELERATION * d / acceleration))),
    )


def posture_over(scene: SceneConfig, robot: Robot, T_world_level: Array, above_m: float) -> Array:
    """Return `grasp_posture` from home or, near a singularity or on another branch, the posture nearest to home."""
    left, right = (raised(T_world_level @ T, above_m) for T in grasp_offsets(scene))
    nearest = posture_at(robot, (left, right), robot.home, robot.home)
    with suppress(PoseUnreachableError):
        over = grasp_posture(scene, robot, T_world_level, robot.home, above_m=above_m)
        postures = (over, grasp_posture(scene, robot, T_world_level, over))
        jacobians = Kinematics(robot).tcp_jacobians
        hands = [J[:, robot.joints_of(arm)] for q in postures for arm, J in enumerate(jacobians(q))]
        if np.linalg.cond(hands).max() < SLOW_AT[0] and np.abs(over - nearest).max() < _BRANCH_RAD:
            return over
    return nearest


def grasp_posture(
    scene: SceneConfig,
    robot: Robot,
    T_level: Array,
    q_near: Array,
    *,
    above_m: float = 0.0,
) -> Array:
    """Return joints (n,) with both hands `above_m` over their grasps.

    `T_level` is the level object's pose; the search starts at `q_near` to keep the arms' configuration.

    Raises:
        PoseUnreachableError: No solution near `q_near`.
    """
    return posture_at(robot, [raised(T_level @ T, above_m) for T in grasp_offsets(scene)], q_near)


def object_duration_s(
    scene: SceneConfig,
    robot: Robot,
    start: Waypoint,
    end: Waypoint,
    q_near: Array,
    pace: PaceConfig,
) -> tuple[float, Array]:
    """Return the time [s] of a straight held motion, and the end posture; waypoint times are ignored.

    Raises:
        PoseUnreachableError: A hand cannot follow.
    """
    a, b = (np.array([*w.xyz_m, w.yaw_rad]) for w in (start, end))
    postures = [q_near]
    for k in range(_SAMPLES + 1):
        x, y, z, yaw = a + minimum_jerk(k / _SAMPLES)[0] * (b - a)
        postures.append(grasp_posture(scene, robot, level_pose(x, y, z, yaw), postures[-1]))
    q = np.array(postures[1:])
    # Samples are even in time: differences give speeds and accelerations for a duration of 1 s.
    speed = np.abs(np.diff(q, axis=0)) * _SAMPLES / (pace.joint_speed_share * robot.v_max)
    acceleration = (
        np.abs(np.diff(q, 2, axis=0)) * _SAMPLES**2 / (pace.joint_acceleration_share * robot.a_max)
    )
    distance = float(np.linalg.norm(b[:3] - a[:3]))
    turn = float(abs(b[3] - a[3]))
    return max(
        _LEAST_S,
        _time(distance, pace.object_speed_m_per_s, pace.object_acceleration_m_per_s2),
        _time(turn, pace.object_turn_rad_per_s, pace.object_turn_rad_per_s2),
        float(speed.max()),
        float(np.sqrt(acceleration.max())),
    ), q[-1]


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
    s, ds, dds = np.array([minimum_jerk(k / steps) for k in range(steps + 1)]).T[:, :, None] * (
        q1 - q0
    )
    times: Array = np.arange(steps + 1, dtype=float) * dt_s
    return Trajectory(times, q0 + s, ds / times[-1], dds / times[-1] ** 2, "both_arms")


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


def held_motion(
    phase: str,
    path: ObjectPath,
    T_level_object: Array,
    squeeze_n: float,
) -> tuple[HeldMotion, Callable[[float], float]]:
    """Return a phase's object motion, and its internal force [N] by time [s].

    squeeze: ramp up at the path's start; carry: the path, plus rest; unload: ramp down at its end. Ramps keep
    controller C's rate.
    """
    ramp_s = max(PHASES[phase].force_s, squeeze_n / SQUEEZE_RATE_N_PER_S)
    if phase == "squeeze":
        most = min(_TESTED, SQUEEZE_MAX_N / max(squeeze_n, 1.0))
        duration_s = (2.0 * most - 1.0) * ramp_s + PHASES["settle"].force_s
        motion = HeldMotion(path, T_level_object, -duration_s, duration_s)
        return (
            motion,
            lambda t_s: squeeze_n * min(t_s / ramp_s, max(1.0, 2.0 * most - t_s / ramp_s)),
        )
    if phase == "carry":
        return HeldMotion(
            path,
            T_level_object,
            0.0,
            path.duration_s + LANDED_S,
        ), lambda _: squeeze_n
    motion = HeldMotion(path, T_level_object, path.duration_s, ramp_s)
    return motion, lambda t_s: squeeze_n * (1.0 - min(1.0, t_s / ramp_s))


def plan_path(
    scene: SceneConfig,
    robot: Robot,
    pace: PaceConfig,
    goal: Placement,
    T_world_object: Array,
    q: Array,
    rest_m: float,
) -> ObjectPath:
    """Return the path to `goal` (x [m], y [m], yaw [rad]), as fast as limits allow.

    rest_m: sensed height of the object on the table.

    Raises:
        PoseUnreachableError: A hand cannot follow.
    """
    (x, y, yaw) = placement(T_world_object)
    z = float(T_world_object[2, 3])
    gx, gy, goal_yaw = goal
    high = z + scene.task.lift_height_m
    waypoints = [Waypoint((x, y, z), yaw, 0.0)]
    ends = [
        ((x, y, high), yaw),
        ((gx, gy, high), goal_yaw),
        ((gx, gy, rest_m + pace.landing_m), goal_yaw),
    ]
    for xyz, direction in ends:
        duration_s, q = object_duration_s(
            scene,
            robot,
            waypoints[-1],
            Waypoint(xyz, direction, 0.0),
            q,
            pace,
        )
        waypoints.append(Waypoint(xyz, direction, duration_s))
    if pace.landing_m > 0.0:
        waypoints.append(Waypoint((gx, gy, rest_m), goal_yaw, pace.landing_s))
    return ObjectPath(waypoints[0], waypoints[1:])


def held_object(
    scene: SceneConfig,
    T_world_object: Array,
    T_world_tcps: tuple[Array, Array],
) -> HeldObject:
    """Return the law's object model."""
    rod = scene.object
    left, right = (inverse(T_world_object) @ T for T in T_world_tcps)
    return HeldObject(
        rod.mass_kg,
        np.diag(rod.inertia_kg_m2),
        (left, right),
        np.array([0.0, 1.0, 0.0]),
    )
