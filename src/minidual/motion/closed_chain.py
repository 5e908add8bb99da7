"""Move an object that both hands hold: one path of 14 joints on which neither grasp slips.

The object leads: its path is known, so each hand's pose follows from its grasp, and inverse kinematics continues
from one point of the path to the next (both arms move as little as they can). What the hands do on a spline through
those points is measured between them too, and the points are set closer until it is less than half of what is allowed;
then the spline is timed with the joints' limits and the object's own speed and acceleration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from minidual.collision.errors import ClosedChainError
from minidual.collision.scene import Attached, PlanningScene
from minidual.collision.shapes import Shape
from minidual.motion.goals import check_joints
from minidual.motion.hands_ik import HandsIK, require_followed
from minidual.motion.held_path import (
    RESIDUAL_MAX_M,
    RESIDUAL_MAX_RAD,
    CarriedTrajectory,
    HeldCurve,
    ObjectLimits,
    fine_curve,
    timed,
)
from minidual.motion.ik import check_pose
from minidual.motion.object_path import ObjectPath
from minidual.motion.timing import MotionLimits
from minidual.proof.scene_engines import SceneEngines
from minidual.proof.verify import Verification
from minidual.robot.constants import ARMS, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import inverse
from minidual.robot.trajectory import Trajectory

CARRY_LIMITS = MotionLimits(smoothing_s=0.1)
"""Limits with an object in the hands: softer starts and stops than for empty hands."""
_CORNER_M = 0.04


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
    return replace(shape, position_m=tuple(float(v) for v in position), quat_wxyz=tuple(float(v) for v in quat))


class CarriedPlanner:
    """Plans for objects that both hands hold. One instance a process: it holds workspaces."""

    def __init__(self, limits: MotionLimits | None = None) -> None:
        self._kinematics = Kinematics()
        self._limits = limits or CARRY_LIMITS

    def plan(
        self,
        q_start: Array,
        Ts_world_object: Sequence[Array],
        T_object_tcp_left: Array,
        T_object_tcp_right: Array,
        *,
        object_limits: ObjectLimits | None = None,
        scene: PlanningScene | None = None,
        corner_m: float = _CORNER_M,
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
                residual stays over half of 0.1 mm or of 0.05 degrees, or the proof fails; each with its numbers.
            OutOfLimitsError, UsageError: A bad start or pose.
        """
        q_start = check_joints(q_start, "start")
        grasps = (check_pose(T_object_tcp_left, "the left grasp"), check_pose(T_object_tcp_right, "the right grasp"))
        hands = HandsIK(*grasps, self._kinematics)
        object_path = ObjectPath(Ts_world_object, corner_m)
        require_held(hands, q_start, object_path.pose(0.0))
        curve, residual_m, residual_rad = continued(hands, object_path, q_start)
        trajectory, poses = timed(
            curve, object_path.chart, object_limits or ObjectLimits(), self._limits, self._kinematics
        )
        verification = None if scene is None else self._prove(trajectory, scene)
        return CarriedTrajectory(
            trajectory.times,
            trajectory.q,
            trajectory.v,
            trajectory.a,
            trajectory.group,
            poses,
            residual_m,
            residual_rad,
            verification,
        )

    def _prove(self, trajectory: Trajectory, scene: PlanningScene) -> Verification:
        report = SceneEngines(scene).verifier.verify(trajectory)
        if not report.ok:
            raise ClosedChainError(f"the carried path is not free: {report.reason}")
        return report


def require_held(hands: HandsIK, q: Array, T_world_object: Array) -> None:
    """Check that both hands are at their grasps at q (14,).

    Raises:
        ClosedChainError: A hand is off; with arm and numbers.
    """
    for arm, (distance, angle) in zip(ARMS, hands.off_grasp(q, T_world_object), strict=True):
        if not (distance <= RESIDUAL_MAX_M and angle <= RESIDUAL_MAX_RAD):
            raise ClosedChainError(
                f"at the start the {arm} hand is {distance * 1e3:.2f} mm and {angle:.4f} rad off its grasp",
                remedy="take the grasps from the hands as they are (grasp_of), or solve the start first",
            )


def continued(hands: HandsIK, object_path: ObjectPath, q_start: Array) -> tuple[HeldCurve, float, float]:
    """Return the curve of an object's path continued from q_start (14,), and its residual ([m], [rad]).

    Raises:
        ClosedChainError: A hand cannot follow, an arm would jump, or the residual stays too large.
    """

    def solve(_marks: Array, Ts_world_object: Array) -> Array:
        Q, stuck = hands.follow(Ts_world_object, q_start)
        require_followed(stuck, Ts_world_object)
        return Q

    return fine_curve(hands, object_path.chart, object_path.length, object_path.knots, object_path.coordinates, solve)


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
        q_start, Ts_world_object, T_object_tcp_left, T_object_tcp_right, object_limits=object_limits, scene=scene
    )
