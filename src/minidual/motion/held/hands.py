"""IK of both hands on one object."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from minidual.collision.errors import ClosedChainError
from minidual.motion.checks import check_pose, place_text
from minidual.motion.ik import solvers
from minidual.robot.pair import Array, Robot, inverse

_LIMIT_BAND_RAD = 0.35
_LIMIT_PUSH_RAD_PER_M = 3.0
_RELAX_STEPS_N = 12
_RELAX_STEP_M = 0.05
_ARM_M = 0.2
_ROUNDING_RAD = 1e-6  # beyond a limit: a start on a limit is solved again to either side of it
JUMP_MAX_RAD = 0.15
"""Larger joint steps between path points are jumps."""
RESIDUAL_MAX_M = 1e-4
RESIDUAL_MAX_RAD = float(np.deg2rad(0.05))


class Followed(NamedTuple):
    """Joints along object poses.

    Attributes:
        Q: (m, n) [rad].
        error: Why the hands cannot follow farther, or None.
    """

    Q: Array
    error: ClosedChainError | None


class HandsIK:
    """IK of both arms at the grasps T_object_tcp (4, 4).

    Solutions are projections without limits, hence smooth; those outside the limits are discarded.

    Raises:
        UsageError: A grasp is no rigid pose.
    """

    def __init__(self, grasps: tuple[Array, Array], robot: Robot) -> None:
        left, right = grasps
        self.grasps = check_pose(left, "the left grasp"), check_pose(right, "the right grasp")
        self.robot = robot
        self.arms = tuple(solvers(robot).values())

    def _nearest(self, T_world_object: Array, q_near: Array, wish: Array | None = None) -> Array:
        """Return q (n,) at the grasps; failed arms are NaN."""
        q = np.full(len(q_near), np.nan)
        for arm, grasp in zip(self.arms, self.grasps, strict=True):
            arm_wish = None if wish is None else wish[arm.joints]
            solution = arm.nearest(T_world_object @ grasp, q_near[arm.joints], arm_wish)
            if solution is not None:
                q[arm.joints] = solution
        return q

    def solve(
        self,
        T_world_object: Array,
        q_near: Array,
        wish: Array | None = None,
    ) -> Array | None:
        """Return q (n,) at the grasps, projected from q_near (n,).

        None if unsolved or outside limits. `wish` (n,) is a preferred step from q_near.
        """
        q = self._nearest(T_world_object, q_near, wish)
        inside = np.clip(q, self.robot.q_lower, self.robot.q_upper)
        # Also false for NaN.
        return inside if np.abs(inside - q).max() <= _ROUNDING_RAD else None

    def elbow_swing(self, q: Array, swings_rad: Array) -> Array:
        """Return a null-space step (n,) by `swings_rad` (2,); zero for six-joint arms."""
        step = np.zeros_like(q)
        for arm, swing in zip(self.arms, swings_rad, strict=True):
            _, J = arm.error_and_jacobian(q[arm.joints], arm.tcp_pose(q[arm.joints]))
            right_vectors = np.linalg.svd(J)[2]
            if len(right_vectors) <= 6:
                continue
            free = right_vectors[6]
            largest = free[np.argmax(np.abs(free))]
            step[arm.joints] = swing * (free if largest > 0.0 else -free)
        return step

    def off_limits(self, q: Array) -> Array:
        """Return a preferred motion (n,) away from joint limits [rad per metre of object motion].

        Zero beyond 0.35 rad from them, quadratic inside.
        """
        low = np.maximum(0.0, _LIMIT_BAND_RAD - (q - self.robot.q_lower)) / _LIMIT_BAND_RAD
        high = np.maximum(0.0, _LIMIT_BAND_RAD - (self.robot.q_upper - q)) / _LIMIT_BAND_RAD
        return _LIMIT_PUSH_RAD_PER_M * (low**2 - high**2)

    def relaxed(self, T_world_object: Array, q: Array) -> Array:
        """Return a posture (n,) at the same pose, farther from joint limits where possible."""
        for _ in range(_RELAX_STEPS_N):
            wish = _RELAX_STEP_M * self.off_limits(q)
            if not wish.any():
                break
            moved = self.solve(T_world_object, q, wish)
            if moved is None:
                break
            q = moved
        return q

    def follow(self, Ts_world_object: Array, q_start: Array) -> Followed:
        """Follow object poses (n, 4, 4) from q_start at the first, away from joint limits."""
        robot = self.robot
        Q = np.empty((len(Ts_world_object), len(q_start)))
        Q[0] = q_start
        for k in range(1, len(Q)):
            T = Ts_world_object[k]
            way = _way(Ts_world_object[k - 1], T)
            Q[k] = self._nearest(T, Q[k - 1], way * self.off_limits(Q[k - 1]))
            inside = (Q[k] >= robot.q_lower) & (Q[k] <= robot.q_upper)
            step = np.abs(Q[k] - Q[k - 1]).max()
            if not (step <= JUMP_MAX_RAD and inside.all()):
                return Followed(Q[:k], self._follow_error(T, Q[k - 1], Q[k]))
        return Followed(Q, None)

    def _follow_error(self, T_world_object: Array, before: Array, q: Array) -> ClosedChainError:
        """Return why the hands cannot follow from `before` to q (n,); arms that failed are NaN."""
        robot = self.robot
        where = place_text(T_world_object)
        remedy = (
            "choose waypoints within reach of both arms, or another grasp or posture to start from"
        )
        for arm, grasp in zip(self.arms, self.grasps, strict=True):
            if not np.isfinite(q[arm.joints]).all():
                solution = arm.solve(T_world_object @ grasp, before[arm.joints])
                if not solution.reached:
                    return ClosedChainError(
                        f"the {arm.arm} hand cannot follow the object to {where}: it stays"
                        f" {solution.off} away",
                        remedy=remedy,
                    )
                q[arm.joints] = solution.q
        steps = np.abs(q - before)
        if float(steps.max()) > JUMP_MAX_RAD:
            joint = int(np.argmax(steps))
            reason = (
                f"would jump by {steps[joint]:.2f} rad within a step (a joint limit or a singular"
                " posture)"
            )
        else:
            joint = int(np.argmax(np.maximum(robot.q_lower - q, q - robot.q_upper)))
            low = robot.q_lower[joint]
            high = robot.q_upper[joint]
            reason = f"would go to {q[joint]:.3f} rad, its limits are {low:.3f} to {high:.3f} rad"
        side = robot.sides[robot.arm_of_joint[joint]]
        return ClosedChainError(
            f"the {side} hand cannot follow the object to {where}:"
            f" {robot.joint_names[joint]} {reason}",
            remedy=remedy,
        )

    def require_held(self, q: Array, T_world_object: Array) -> None:
        """Check the grasps at q (n,) for an object pose (4, 4), to 0.1 mm and 0.05 degrees.

        Raises:
            ClosedChainError: A hand is off its grasp.
        """
        for arm, grasp in zip(self.arms, self.grasps, strict=True):
            tcp = arm.tcp_pose(q[arm.joints])
            distance, angle = _apart(tcp[None], (T_world_object @ grasp)[None])
            if not (distance <= RESIDUAL_MAX_M and angle <= RESIDUAL_MAX_RAD):
                raise ClosedChainError(
                    f"at the start the {arm.arm} hand is {distance * 1e3:.2f} mm and"
                    f" {angle:.4f} rad off its grasp",
                    remedy="take the grasps from the hands as they are, or solve the start first",
                )

    def strays(self, Q: Array, Ts_world_object: Array) -> tuple[float, float]:
        """Return the largest error of grasps or between hands ([m], [rad]) at Q (m, n)."""
        left, right = (np.array([arm.tcp_pose(q) for q in Q[:, arm.joints]]) for arm in self.arms)
        left_grasp, right_grasp = self.grasps
        T_left_right = inverse(left_grasp) @ right_grasp
        errors = [
            _apart(left, Ts_world_object @ left_grasp),
            _apart(right, Ts_world_object @ right_grasp),
            _apart(right, left @ T_left_right),
        ]
        off_m, off_rad = np.max(errors, axis=0).tolist()
        return off_m, off_rad


def _way(T_from: Array, T_to: Array) -> float:
    """Return the way between two poses (4, 4) [m], with rotation at a lever of 0.2 m."""
    turn = float(np.linalg.norm(pin.log3(T_from[:3, :3].T @ T_to[:3, :3])))
    shift = np.linalg.norm(T_to[:3, 3] - T_from[:3, 3])
    return float(np.hypot(shift, _ARM_M * turn))


def _apart(A: Array, B: Array) -> tuple[float, float]:
    """Return the largest distance [m] and angle [rad] of poses (m, 4, 4)."""
    R = np.swapaxes(A[:, :3, :3], 1, 2) @ B[:, :3, :3]
    vee = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]])
    sines = 0.5 * np.linalg.norm(vee, axis=0)
    cosines = 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0)
    angles = np.arctan2(sines, cosines)
    distances = np.linalg.norm(A[:, :3, 3] - B[:, :3, 3], axis=1)
    return float(distances.max()), float(angles.max())
