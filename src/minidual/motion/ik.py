"""Inverse kinematics: from far away inside the joint limits, from close by, or near a reference posture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from minidual.collision.errors import IKUnreachableError
from minidual.errors import UsageError, unknown_name
from minidual.motion.ik_descent import descend, frames_of_arm, measure, project, tcp_pose
from minidual.robot.compiled import floats
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.robot.vectors import cross, inner

TOLERANCE = 1e-7
"""Norm of the SE(3) error [m and rad together] at which the pose counts as reached."""
_ITERATIONS = 80
_DISTINCT_RAD = 0.1
_SMALL = 1e-4
_NEAR_ITERATIONS = 8
_NEAR_STEP_MAX_RAD = 1.0
_REST_ITERATIONS, _REST_STEP_MAX_RAD, _REST_DAMPING = 60, 0.2, 1e-9
_REST_TOLERANCE_RAD = 1e-5


@dataclass(frozen=True)
class IKSolution:
    """Joints q (n,) of one arm and what is left of the error."""

    q: Array
    residual_m: float
    residual_rad: float
    reached: bool


def check_pose(T: Array, what: str) -> Array:
    """Return T as a (4, 4) array.

    Raises:
        UsageError: Wrong shape, a value that is not finite, or no rotation in it.
    """
    T = np.asarray(T, dtype=float)
    if T.shape != (4, 4):
        raise UsageError(f"{what} has shape {T.shape}; a pose is (4, 4)")
    # Plain floats: ten times faster than arrays on so few numbers.
    x, y, z, last = T.tolist()
    if not all(map(math.isfinite, (*x, *y, *z, *last))):
        raise UsageError(f"{what} holds a value that is not finite: {T.ravel().tolist()}")
    rows = x[:3], y[:3], z[:3]
    off = max(abs(inner(u, v) - (u is v)) for u in rows for v in rows)
    det = inner(cross(rows[0], rows[1]), rows[2])
    if off > 1e-6 or det < 0.0 or max(map(abs, (*last[:3], last[3] - 1.0))) > 1e-9:
        raise UsageError(f"{what} is no rigid pose: R R^T is {off:.2g} from the identity, det {det:.3f}")
    return T


class ArmIK:
    """Inverse kinematics of one arm to its tcp, in the world frame.

    Args:
        arm: "left" or "right".
        kinematics: Of the robot; the default robot's if left out.
    """

    def __init__(self, arm: str, kinematics: Kinematics | None = None) -> None:
        kinematics = kinematics or Kinematics()
        robot = kinematics.robot
        if arm not in robot.sides:
            raise unknown_name("arm", arm, robot.sides)
        self.arm = arm
        self.joints = robot.groups[f"{arm}_arm"]
        self._n = robot.dof_per_arm
        self._frames = frames_of_arm(kinematics.model, self.joints, kinematics.tcp_ids[robot.sides.index(arm)])
        self.lower, self.upper = robot.q_lower[self.joints].copy(), robot.q_upper[self.joints].copy()
        self._home = robot.home[self.joints].copy()

    def tcp_pose(self, q: Array) -> Array:
        """Return T_world_tcp (4, 4) at q (n,)."""
        T = np.empty((4, 4))
        tcp_pose(self._frames, floats(q).reshape(self._n), T)
        return T

    def error_and_jacobian(self, q: Array, T_world_tcp: Array) -> tuple[Array, Array]:
        """Return the error log6(T_tcp_target) (6,) and its derivative by q (6, n)."""
        error, J = np.empty(6), np.empty((6, self._n))
        measure(self._frames, floats(T_world_tcp).reshape(4, 4), floats(q).reshape(self._n), error, J)
        return error, J

    def solve(self, T_world_tcp: Array, q_start: Array, iterations: int = _ITERATIONS) -> IKSolution:
        """Descend from q_start (n,) to the pose inside the limits; `reached` tells whether the tolerance was met."""
        q = np.clip(floats(q_start).reshape(self._n), self.lower, self.upper)
        target = floats(T_world_tcp).reshape(4, 4)
        off, residual_m, residual_rad = descend(self._frames, target, q, self.lower, self.upper, iterations, TOLERANCE)
        return IKSolution(q, residual_m, residual_rad, off < TOLERANCE)

    def nearest(self, T_world_tcp: Array, q_near: Array, wish: Array | None = None) -> Array | None:
        """Return joints (n,) at the pose by steps of least norm from q_near (n,), or None.

        Limits are not looked at: the result is a smooth function of pose, q_near and wish.

        Args:
            T_world_tcp: Pose (4, 4).
            q_near: A configuration close by.
            wish: Step (n,) [rad] that the first step comes as near to as the pose lets it.
        """
        q = np.array(q_near, dtype=float)
        wish = np.zeros(self._n) if wish is None else floats(wish)
        target = floats(T_world_tcp)
        return q if project(self._frames, target, q, wish, _NEAR_ITERATIONS, _SMALL, _NEAR_STEP_MAX_RAD) else None

    def resting(
        self, T_world_tcp: Array, q_start: Array, posture: Array, mobility: Array, margin_rad: float = 0.02
    ) -> IKSolution:
        """Minimise sum_i (q_i - posture_i)^2 / mobility_i at the pose: an answer that forgets where it came from.

        Gauss-Newton on the pose, and steps towards the posture projected into its null space in the metric of the
        costs (Nakamura, "Advanced Robotics", 1991, ch. 4).

        Args:
            T_world_tcp: Pose (4, 4).
            q_start: Start (n,); along a path the solution before, so that the branch never changes.
            posture: Reference (n,) [rad].
            mobility: (n,) one over the cost of moving each joint.
            margin_rad: Distance to keep from the joint limits.
        """
        lower, upper = self.lower + margin_rad, self.upper - margin_rad
        q, reached = np.array(q_start, dtype=float), False
        damping = _REST_DAMPING * np.eye(6)  # a stretched arm slows down instead of lashing out
        for _ in range(_REST_ITERATIONS):
            e, J = self.error_and_jacobian(q, T_world_tcp)
            weighted = J * mobility
            pinv = np.linalg.solve(weighted @ J.T + damping, weighted).T
            wish = posture - q
            stay = wish - pinv @ (J @ wish)
            reached = bool(np.abs(e).max() < TOLERANCE)
            if reached and np.abs(stay).max() < _REST_TOLERANCE_RAD:
                break
            q = np.clip(q + np.clip(stay - pinv @ e, -_REST_STEP_MAX_RAD, _REST_STEP_MAX_RAD), lower, upper)
        # At the limits, or where the posture oscillates within its tolerance, the hand may still be there.
        return IKSolution(q, float(np.abs(e[:3]).max()), float(np.abs(e[3:]).max()), bool(np.abs(e).max() < _SMALL))

    def solutions(
        self, T_world_tcp: Array, q_near: Array, rng: np.random.Generator, restarts_n: int
    ) -> Iterator[Array]:
        """Yield distinct solutions (n,): the descent from q_near first, then from home and from random starts.

        Raises:
            IKUnreachableError: None of `restarts_n` starts reached the pose; the message names the best residual.
        """
        found: list[Array] = []
        best: IKSolution | None = None
        for attempt in range(restarts_n):
            if attempt == 0:
                start = q_near
            elif attempt == 1:
                start = self._home
            else:
                start = rng.uniform(self.lower, self.upper)
            solution = self.solve(T_world_tcp, start)
            if solution.reached:
                if all(np.max(np.abs(solution.q - q)) > _DISTINCT_RAD for q in found):
                    found.append(solution.q)
                    yield solution.q
            elif best is None or solution.residual_m + solution.residual_rad < best.residual_m + best.residual_rad:
                best = solution
        if not found and best is not None:
            x, y, z = T_world_tcp[:3, 3]
            raise IKUnreachableError(
                f"the {self.arm} hand cannot reach ({x:.3f}, {y:.3f}, {z:.3f}) m as asked: the best of {restarts_n} "
                f"starts stays {best.residual_m * 1e3:.1f} mm and {best.residual_rad:.3f} rad away",
                remedy="move the goal nearer to the base or change its orientation",
            )


class PostureIK:
    """Both hands at given poses, the joints close to a reference posture.

    The same poses always give the same joints, whatever came before, so a policy can learn them.

    Args:
        kinematics: Of the robot.
        posture: (n,) [rad] to stay close to.
        weights: (joints of an arm,) cost of moving each of them away from it; equal by default.
    """

    def __init__(self, kinematics: Kinematics, *, posture: Array, weights: Array | None = None) -> None:
        self._arms = tuple(ArmIK(side, kinematics) for side in kinematics.robot.sides)
        self._posture = posture
        self._mobility = 1.0 / (np.ones(kinematics.robot.dof_per_arm) if weights is None else np.asarray(weights))

    def solve(self, T_world_left: Array, T_world_right: Array, q_start: Array) -> Array:
        """Return q (n,) [rad] with both tool centre points at the given poses (4, 4), found from q_start.

        Raises:
            UsageError: A pose is out of reach, or only reached outside the joint limits.
        """
        q = np.array(q_start, dtype=float)
        for arm, T in zip(self._arms, (T_world_left, T_world_right), strict=True):
            found = arm.resting(T, q[arm.joints], self._posture[arm.joints], self._mobility)
            if not found.reached:
                raise UsageError(
                    f"the {arm.arm} hand cannot reach position {np.round(T[:3, 3], 3).tolist()} m: "
                    f"{found.residual_m * 1e3:.1f} mm and {found.residual_rad:.3f} rad remain",
                    remedy="keep the object within reach: a smaller start range, or a start nearer to the arms",
                )
            q[arm.joints] = found.q
        return q
