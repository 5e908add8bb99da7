"""Motions of a carry, internal-force ramps, and the object model of controller C."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minidual.config.control import PaceConfig
from minidual.config.scene import SceneConfig
from minidual.control.object_controller import SQUEEZE_RATE_N_PER_S
from minidual.control.object_impedance import HeldObject, ObjectState
from minidual.control.object_path import ObjectPath, Waypoint
from minidual.robot.pair import Array, Robot
from minidual.robot.poses import inverse
from minidual.robot.trajectory import Trajectory
from minidual.skills.pace import joint_duration_s, object_duration_s
from minidual.skills.phases import PHASES
from minidual.tasks.rod_carry import level_part

LANDED_S = 0.1
"""Rest time before release."""


def joint_move(
    q0: Array, q1: Array, robot: Robot, pace: PaceConfig, dt_s: float, duration_s: float | None = None
) -> Trajectory:
    """Return a minimum-jerk motion of both arms, by default as fast as `pace` allows."""
    steps = int(np.ceil((joint_duration_s(q0, q1, pace, robot) if duration_s is None else duration_s) / dt_s))
    s, way, whole_s = (np.arange(steps + 1) / steps)[:, None], q1 - q0, steps * dt_s
    q = q0 + s**3 * (10.0 + s * (6.0 * s - 15.0)) * way
    v = 30.0 * s**2 * (1.0 - s) ** 2 / whole_s * way
    a = 60.0 * s * (1.0 + s * (2.0 * s - 3.0)) / whole_s**2 * way
    times: Array = np.arange(steps + 1, dtype=float) * dt_s
    return Trajectory(times, q, v, a, "both_arms")


@dataclass(frozen=True)
class HeldMotion:
    """Object motion along level poses, tilted as grasped by `T_level_object` (`control.commands.ObjectMotion`).

    `rests_at_s` holds one path time throughout.
    """

    path: ObjectPath
    T_level_object: Array
    duration_s: float
    rests_at_s: float | None = None

    def at(self, t_s: float) -> ObjectState:
        """Return the object state at a time [s]."""
        state = self.path.at(t_s if self.rests_at_s is None else self.rests_at_s)
        return ObjectState(state.T_world_object @ self.T_level_object, state.twist, state.acceleration)


@dataclass(frozen=True)
class Squeeze:
    """Linear ramp of the internal force [N], then constant."""

    start_n: float
    end_n: float
    ramp_s: float

    def __call__(self, t_s: float) -> float:
        """Return the internal force [N] at a time [s]."""
        return self.start_n + min(1.0, t_s / self.ramp_s) * (self.end_n - self.start_n)


def held_motion(phase: str, path: ObjectPath, T_level_object: Array, squeeze_n: float) -> tuple[HeldMotion, Squeeze]:
    """Return a phase's object motion and internal force.

    squeeze: ramp up at the path's start; carry: the path, plus landing; unload: ramp down at its end. The ramps keep
    controller C's rate.
    """
    ramp_s = max(PHASES[phase].force_s, squeeze_n / SQUEEZE_RATE_N_PER_S)
    if phase == "squeeze":
        motion = HeldMotion(path, T_level_object, ramp_s + PHASES["settle"].force_s, rests_at_s=0.0)
        return motion, Squeeze(0.0, squeeze_n, ramp_s)
    if phase == "carry":
        return HeldMotion(path, T_level_object, path.duration_s + LANDED_S), Squeeze(squeeze_n, squeeze_n, ramp_s)
    return HeldMotion(path, T_level_object, ramp_s, rests_at_s=path.duration_s), Squeeze(squeeze_n, 0.0, ramp_s)


def plan_path(
    scene: SceneConfig,
    robot: Robot,
    pace: PaceConfig,
    goal: tuple[float, float, float],
    T_world_object: Array,
    q: Array,
) -> ObjectPath:
    """Return the path to `goal` (x [m], y [m], yaw [rad]), as fast as limits allow.

    Raises:
        GraspUnreachableError: A hand cannot follow.
    """
    x, y, z = T_world_object[:3, 3]
    level = level_part(T_world_object)
    yaw = float(np.arctan2(level[1, 0], level[0, 0]))
    gx, gy, goal_yaw = goal
    high, rest = z + scene.task.lift_height_m, scene.object.rest_height_m
    start = place = Waypoint((x, y, z), yaw, 0.0)
    waypoints: list[Waypoint] = []
    ends = [((x, y, high), yaw), ((gx, gy, high), goal_yaw), ((gx, gy, rest + pace.landing_m), goal_yaw)]
    for xyz, direction in ends:
        end = Waypoint(xyz, direction, 0.0)
        duration_s, q = object_duration_s(scene, robot, place, end, q, pace)
        waypoints.append(Waypoint(xyz, direction, duration_s))
        place = end
    if pace.landing_m > 0.0:
        waypoints.append(Waypoint((gx, gy, rest), goal_yaw, pace.landing_s))
    return ObjectPath(start, waypoints)


def held_object(scene: SceneConfig, T_world_object: Array, T_world_tcps: tuple[Array, Array]) -> HeldObject:
    """Return the law's object model."""
    rod = scene.object
    left, right = (inverse(T_world_object) @ T for T in T_world_tcps)
    return HeldObject(rod.mass_kg, np.diag(rod.inertia_kg_m2), (left, right), np.array([0.0, 1.0, 0.0]))
