"""Motions of a carry, internal-force ramps, and the parameters of controller C."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minidual.config.control import CarryConfig, ImpedanceConfig
from minidual.config.scene import SceneConfig
from minidual.control.object_controller import SQUEEZE_RATE_N_PER_S
from minidual.control.object_impedance import HeldObject, ImpedanceGains, ObjectState
from minidual.control.object_path import ObjectPath, Waypoint
from minidual.robot.pair import Array, Robot
from minidual.robot.poses import inverse
from minidual.skills.pace import object_duration_s
from minidual.skills.phases import PHASES
from minidual.tasks.rod_carry import level_part

LANDED_S = 0.1
"""Rest time before release."""


class JointMove:
    """A minimum-jerk motion of both arms (`control.commands.TimedMotion`).

    Attributes:
        q, v, a: (k, n) on the grid.
    """

    def __init__(self, q0: Array, q1: Array, duration_s: float, dt_s: float) -> None:
        self._q0, self._way, self.dt_s, self.duration_s = q0, q1 - q0, dt_s, duration_s
        steps = int(np.ceil(duration_s / dt_s - 1e-6))
        self.q, self.v, self.a = self.sample_many(np.minimum(np.arange(steps + 1) * dt_s, duration_s))

    def sample_many(self, times: Array) -> tuple[Array, Array, Array]:
        """Return (q, v, a), each (m, n), at times (m,) [s]; at rest outside."""
        duration, way = self.duration_s, self._way
        s = np.clip(np.asarray(times, dtype=float) / duration, 0.0, 1.0)[:, None]
        blend = s**3 * (10.0 + s * (6.0 * s - 15.0))
        rate = 30.0 * s**2 * (1.0 - s) ** 2
        curvature = 60.0 * s * (1.0 + s * (2.0 * s - 3.0))
        return self._q0 + blend * way, rate / duration * way, curvature / duration**2 * way


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
    """Linear ramp of the internal force [N], then constant; zero `ramp_s` gives `end_n`."""

    start_n: float
    end_n: float
    ramp_s: float = 0.0

    def __call__(self, t_s: float) -> float:
        """Return the internal force [N] at a time [s]."""
        share = min(1.0, t_s / self.ramp_s) if self.ramp_s > 0.0 else 1.0
        return self.start_n + share * (self.end_n - self.start_n)


def squeezing(path: ObjectPath, T_level_object: Array, squeeze_n: float) -> tuple[HeldMotion, Squeeze]:
    """Return the internal-force ramp-up at the path's start, within controller C's rate."""
    ramp_s = max(PHASES["squeeze"].force_s, squeeze_n / SQUEEZE_RATE_N_PER_S)
    return (
        HeldMotion(path, T_level_object, ramp_s + PHASES["settle"].force_s, rests_at_s=0.0),
        Squeeze(0.0, squeeze_n, ramp_s),
    )


def carrying(path: ObjectPath, T_level_object: Array, squeeze_n: float) -> tuple[HeldMotion, Squeeze]:
    """Return the motion along the path, plus landing."""
    return HeldMotion(path, T_level_object, path.duration_s + LANDED_S), Squeeze(squeeze_n, squeeze_n)


def releasing(path: ObjectPath, T_level_object: Array, squeeze_n: float) -> tuple[HeldMotion, Squeeze]:
    """Return the internal-force ramp to zero at the path's end, within controller C's rate."""
    ramp_s = max(PHASES["unload"].force_s, squeeze_n / SQUEEZE_RATE_N_PER_S)
    return (HeldMotion(path, T_level_object, ramp_s, rests_at_s=path.duration_s), Squeeze(squeeze_n, 0.0, ramp_s))


def plan_path(
    scene: SceneConfig,
    robot: Robot,
    config: CarryConfig,
    goal: tuple[float, float, float],
    T_world_object: Array,
    q: Array,
) -> ObjectPath:
    """Return the path to `goal` (x [m], y [m], yaw [rad]), as fast as limits allow.

    Durations fixed in `config` override the limits.

    Raises:
        GraspUnreachableError: A hand cannot follow.
    """
    x, y, z = T_world_object[:3, 3]
    level = level_part(T_world_object)
    yaw = float(np.arctan2(level[1, 0], level[0, 0]))
    gx, gy, goal_yaw = goal
    high = z + scene.task.lift_height_m
    rest, landing = scene.object.rest_height_m, config.pace.landing_m
    ends = [
        ((x, y, high), yaw, config.lift_s),
        ((gx, gy, high), goal_yaw, config.transport_s),
        ((gx, gy, rest + landing), goal_yaw, config.lower_s),
    ]
    if landing > 0.0:
        ends.append(((gx, gy, rest), goal_yaw, config.pace.landing_s))
    start = place = Waypoint((x, y, z), yaw, 0.0)
    waypoints = []
    for xyz, direction, fixed_s in ends:
        end = Waypoint(xyz, direction, 0.0)
        planned_s, q = object_duration_s(scene, robot, place, end, q, config.pace)
        waypoints.append(Waypoint(xyz, direction, planned_s if fixed_s is None else fixed_s))
        place = end
    return ObjectPath(start, waypoints)


def held_object(scene: SceneConfig, T_world_object: Array, T_world_tcps: tuple[Array, Array]) -> HeldObject:
    """Return the law's object model."""
    rod = scene.object
    left, right = (inverse(T_world_object) @ T for T in T_world_tcps)
    return HeldObject(rod.mass_kg, np.diag(rod.inertia_kg_m2), (left, right), np.array([0.0, 1.0, 0.0]))


def gains(impedance: ImpedanceConfig) -> ImpedanceGains:
    """Return the configured gains."""
    return ImpedanceGains(
        stiffness=(impedance.stiffness_n_per_m,) * 3 + (impedance.stiffness_nm_per_rad,) * 3,
        damping_ratio=impedance.damping_ratio,
        internal_force_n=impedance.internal_force_n,
        force_gain=impedance.force_gain,
        force_correction_max_n=impedance.force_correction_max_n,
    )
