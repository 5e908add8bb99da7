"""Move an object that both hands hold: one path of 14 joints on which neither grasp slips.

The object leads: its path is known, so each hand's pose follows from its grasp, and inverse kinematics continues
from one point of the path to the next (both arms move as little as they can). A spline through those points is
timed by toppra with the joints' limits and the object's own speed and acceleration, and what the hands really do on
the timed path is measured again, between the points too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from minidual.errors import UsageError
from minidual.planning.errors import ClosedChainError
from minidual.planning.goals import check_joints
from minidual.planning.ik import ArmIK, check_pose
from minidual.planning.object_path import ObjectPath
from minidual.planning.scene import Attached, PlanningScene
from minidual.planning.scene_engines import SceneEngines
from minidual.planning.shapes import Shape
from minidual.planning.timing import MotionLimits, drive, fastest_profile
from minidual.planning.trajectory import Trajectory
from minidual.planning.verify import Verification
from minidual.robot.constants import A_MAX, ARMS, GROUPS, V_MAX, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import inverse

RESIDUAL_MAX_M = 1e-4
RESIDUAL_MAX_RAD = 1e-3
_STEP_M = 0.005
_JUMP_MAX_RAD = 0.15
_REFINEMENTS = 3
_RESIDUAL_EVERY = 3


@dataclass(frozen=True)
class ObjectLimits:
    """How fast the object may go: of its centre along the path, and along each axis of the world."""

    speed_m_per_s: float = 0.3
    acceleration_m_per_s2: float = 1.0


@dataclass(frozen=True, eq=False)
class CarriedTrajectory(Trajectory):
    """A trajectory on which both hands keep their grasps.

    Attributes:
        Ts_world_object: Planned pose of the object at every sample, (n, 4, 4).
        residual_m, residual_rad: Largest error of either hand against its grasp along the timed path.
        verification: The proof, if a scene was given.
    """

    Ts_world_object: Array
    residual_m: float
    residual_rad: float
    verification: Verification | None = None


def grasp_of(q: Array, T_world_object: Array, kinematics: Kinematics | None = None) -> tuple[Array, Array]:
    """Return (T_object_tcp_left, T_object_tcp_right) of the hands at q (14,) on an object at a pose."""
    left, right = (kinematics or Kinematics()).tcp_poses(np.asarray(q, dtype=float))
    T_object_world = inverse(T_world_object)
    return T_object_world @ left, T_object_world @ right


def scene_holding(
    scene: PlanningScene, shape: Shape, T_object_tcp_left: Array, *, rests_on: Sequence[str] = ("table",)
) -> PlanningScene:
    """Return the scene with an object in both hands.

    Args:
        scene: Scene around.
        shape: The object, its place given in the object's frame.
        T_object_tcp_left: Grasp of the left hand, whose motion the object follows (so does the right, by plan).
        rests_on: Obstacles that the object may touch, because it is lifted off them and put down on them.
    """
    T_tcp_shape = inverse(T_object_tcp_left) @ shape.T_parent_shape
    quat = pin.Quaternion(T_tcp_shape[:3, :3])
    held = _placed(shape, tuple(T_tcp_shape[:3, 3]), (quat.w, quat.x, quat.y, quat.z))
    hands = tuple(f"{arm}_panda_{part}" for arm in ARMS for part in ("hand", "leftfinger", "rightfinger"))
    scene = scene.with_attached(Attached(held, "left_panda_hand_tcp", hands))
    for obstacle in rests_on:
        scene = scene.allowing(shape.name, obstacle, "the object is lifted off it and put down on it")
    return scene


def _placed(shape: Shape, position: tuple[float, ...], quat: tuple[float, ...]) -> Shape:
    return replace(
        shape, position_m=tuple(float(v) for v in position), quat_wxyz=tuple(float(v) for v in quat)
    )


class _HeldCurve:
    """Columns: 14 joints, 6 coordinates of the object, and s itself, all as functions of s."""

    def __init__(self, spline: CubicSpline, object_path: ObjectPath) -> None:
        self._spline = spline
        self._object = object_path

    @property
    def length(self) -> float:
        return self._object.length

    @property
    def knots(self) -> Array:
        return self._object.knots

    def at(self, s: Array, order: int = 0) -> Array:
        s = np.asarray(s, dtype=float)
        own = s if order == 0 else np.full_like(s, 1.0 if order == 1 else 0.0)
        return np.column_stack([self._spline(s, order), self._object.coordinates(s, order), own])


class CarriedPlanner:
    """Plans for objects that both hands hold. One instance a process: it holds workspaces."""

    def __init__(self, limits: MotionLimits | None = None) -> None:
        self._ik = tuple(ArmIK(arm) for arm in ARMS)
        self._kinematics = Kinematics()
        self._limits = limits or MotionLimits(smoothing_s=0.1)

    def plan(
        self,
        q_start: Array,
        Ts_world_object: Sequence[Array],
        T_object_tcp_left: Array,
        T_object_tcp_right: Array,
        *,
        object_limits: ObjectLimits | None = None,
        scene: PlanningScene | None = None,
        corner_m: float = 0.04,
    ) -> CarriedTrajectory:
        """Return the trajectory that carries the object through its waypoints, at rest at both ends.

        Args:
            q_start: All 14 joints; the hands must be at their grasps on the first waypoint.
            Ts_world_object: Waypoints (4, 4), for example start, lifted, above the goal, goal.
            T_object_tcp_left: Grasp of the left hand, (4, 4).
            T_object_tcp_right: Grasp of the right hand, (4, 4).
            object_limits: Speed and acceleration of the object.
            scene: Prove the result free in this scene (see `scene_holding`); without one nothing is said about
                collisions.
            corner_m: Half length of the rounded corners between waypoints.

        Raises:
            ClosedChainError: The start is off the grasps, a hand cannot follow, the arms would have to jump, the
                residual stays over 0.1 mm or 1 mrad, or the proof fails; each with its numbers.
            OutOfLimitsError, UsageError: A bad start or pose.
        """
        q_start = check_joints(q_start, "start")
        grasps = (
            check_pose(T_object_tcp_left, "the left grasp"),
            check_pose(T_object_tcp_right, "the right grasp"),
        )
        object_path = ObjectPath(Ts_world_object, corner_m)
        self._require_start(q_start, object_path.pose(0.0), grasps)
        step = _STEP_M
        residuals = (np.inf, np.inf)
        for _ in range(_REFINEMENTS):
            curve = _HeldCurve(self._follow(q_start, object_path, grasps, step), object_path)
            trajectory, s = self._time(curve, object_limits or ObjectLimits())
            poses = object_path.poses(s)
            residuals = self.residuals(trajectory, poses, *grasps)
            if residuals[0] < RESIDUAL_MAX_M and residuals[1] < RESIDUAL_MAX_RAD:
                verification = None if scene is None else self._prove(trajectory, scene)
                return CarriedTrajectory(
                    trajectory.times, trajectory.q, trajectory.v, trajectory.a, trajectory.group,
                    poses, *residuals, verification,
                )  # fmt: skip
            step *= 0.5
        raise ClosedChainError(
            f"the hands stray {residuals[0] * 1e3:.3f} mm and {residuals[1]:.5f} rad from their grasps between the "
            f"points of the path; allowed are {RESIDUAL_MAX_M * 1e3} mm and {RESIDUAL_MAX_RAD} rad"
        )

    def residuals(
        self,
        trajectory: Trajectory,
        Ts_world_object: Array,
        T_object_tcp_left: Array,
        T_object_tcp_right: Array,
    ) -> tuple[float, float]:
        """Return the largest error of either hand against object pose and grasp, ([m], [rad]).

        Looked at every third millisecond, several times finer than the points that were solved.
        """
        worst_m = worst_rad = 0.0
        rows = np.append(np.arange(0, len(trajectory.times), _RESIDUAL_EVERY), len(trajectory.times) - 1)
        for k in rows:
            T_object_world = inverse(Ts_world_object[k])
            hands = self._kinematics.tcp_poses(trajectory.q[k])
            for T_world_tcp, T_object_tcp in zip(hands, (T_object_tcp_left, T_object_tcp_right), strict=True):
                distance, angle = _apart(T_object_world @ T_world_tcp, T_object_tcp)
                worst_m, worst_rad = max(worst_m, distance), max(worst_rad, angle)
        return worst_m, worst_rad

    def _require_start(self, q: Array, T_world_object: Array, grasps: tuple[Array, Array]) -> None:
        for arm, hand, grasp in zip(ARMS, self._kinematics.tcp_poses(q), grasps, strict=True):
            distance, angle = _apart(inverse(T_world_object) @ hand, grasp)
            if distance > RESIDUAL_MAX_M or angle > RESIDUAL_MAX_RAD:
                raise ClosedChainError(
                    f"at the start the {arm} hand is {distance * 1e3:.2f} mm and {angle:.4f} rad off its grasp",
                    remedy="take the grasps from the hands as they are (grasp_of), or solve the start first",
                )

    def _follow(
        self, q_start: Array, object_path: ObjectPath, grasps: tuple[Array, Array], step_m: float
    ) -> CubicSpline:
        """Continue inverse kinematics along the path; return q(s) as a spline with rest-like ends."""
        count = max(8, int(np.ceil(object_path.length / step_m)))
        marks = np.linspace(0.0, object_path.length, count + 1)
        Q = np.empty((count + 1, 14))
        Q[0] = q_start
        for k in range(1, count + 1):
            T_world_object = object_path.pose(float(marks[k]))
            for solver, grasp in zip(self._ik, grasps, strict=True):
                joints = GROUPS[f"{solver.arm}_arm"]
                solution = solver.solve(T_world_object @ grasp, Q[k - 1, joints])
                if not solution.reached:
                    x, y, z = T_world_object[:3, 3]
                    raise ClosedChainError(
                        f"the {solver.arm} hand cannot follow the object to ({x:.3f}, {y:.3f}, {z:.3f}) m: it stays "
                        f"{solution.residual_m * 1e3:.1f} mm and {solution.residual_rad:.3f} rad away",
                        remedy="choose waypoints within reach of both arms, or another grasp",
                    )
                jump = float(np.abs(solution.q - Q[k - 1, joints]).max())
                if jump > _JUMP_MAX_RAD:
                    raise ClosedChainError(
                        f"the {solver.arm} arm would jump by {jump:.2f} rad within {step_m * 1e3:.1f} mm of the "
                        "object's path (a joint limit or a singular posture)",
                        remedy="start from another posture of the arm",
                    )
                Q[k, joints] = solution.q
        return CubicSpline(marks, Q, bc_type="natural")

    def _time(self, curve: _HeldCurve, limits: ObjectLimits) -> tuple[Trajectory, Array]:
        for name, value in (("speed", limits.speed_m_per_s), ("acceleration", limits.acceleration_m_per_s2)):
            if not (np.isfinite(value) and value > 0.0):
                raise UsageError(f"the object's {name} limit is {value}; it must be a finite number > 0")
        scale = self._limits
        speed, acceleration = np.full(7, limits.speed_m_per_s), np.full(7, limits.acceleration_m_per_s2)
        v_max = np.concatenate([scale.velocity_scale * V_MAX, speed])
        a_max = np.concatenate([scale.acceleration_scale * A_MAX, acceleration])
        s, sd = fastest_profile(curve, np.arange(21), v_max, a_max)
        return drive(curve, s, sd, "both_arms", scale, self._kinematics)

    def _prove(self, trajectory: Trajectory, scene: PlanningScene) -> Verification:
        report = SceneEngines(scene, self._kinematics).verifier.verify(trajectory)
        if not report.ok:
            raise ClosedChainError(f"the carried path is not free: {report.reason}")
        return report


def _apart(A: Array, B: Array) -> tuple[float, float]:
    """Return distance [m] and angle [rad] between two poses."""
    return float(np.linalg.norm(A[:3, 3] - B[:3, 3])), float(
        np.linalg.norm(pin.log3(A[:3, :3].T @ B[:3, :3]))
    )


def plan_carried_object(
    q_start: Array,
    Ts_world_object: Sequence[Array],
    T_object_tcp_left: Array,
    T_object_tcp_right: Array,
    *,
    object_limits: ObjectLimits | None = None,
    scene: PlanningScene | None = None,
) -> CarriedTrajectory:
    """Plan one carry; see `CarriedPlanner.plan` (keep a planner to plan many)."""
    return CarriedPlanner().plan(
        q_start,
        Ts_world_object,
        T_object_tcp_left,
        T_object_tcp_right,
        object_limits=object_limits,
        scene=scene,
    )
