"""Inverse kinematics that always answers with the same posture for the same hand poses.

Seven joints leave one degree of freedom a hand. It is spent on staying close to a reference posture:

    min sum_i w_i (q_i - q_posture_i)^2   subject to   T_world_tcp(q) = T_goal

solved by Gauss-Newton on the constraint and steps projected, in the metric of w, into its null space (Nakamura,
Advanced Robotics, 1991, ch. 4). Along a path each solution starts from the one before, so the branch never changes, and since the
answer depends on the hand poses alone and not on the way there, a policy can learn it.
"""

from __future__ import annotations

import numpy as np

from minidual.errors import UsageError
from minidual.robot.constants import ARMS, DOF_PER_ARM, Q_LOWER, Q_UPPER, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import rotation_log


class PostureIK:
    """Solves both hands at once.

    Args:
        kinematics: Workspace.
        posture: (14,) [rad] to stay close to.
        weights: (7,) cost of moving each joint of an arm away from it; equal by default.
        tolerance: Largest pose error accepted, metres and radians alike.
        posture_tolerance_rad: Largest null-space step left at the end.
        iterations: Iterations allowed.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        *,
        posture: Array,
        weights: Array | None = None,
        tolerance: float = 1e-7,
        posture_tolerance_rad: float = 1e-5,
        iterations: int = 60,
    ) -> None:
        self._kinematics = kinematics
        self._posture = posture.reshape(2, DOF_PER_ARM)
        self._mobility = np.ones(DOF_PER_ARM) if weights is None else 1.0 / np.asarray(weights, dtype=float)
        self._tolerance = tolerance
        self._posture_tolerance = posture_tolerance_rad
        self._iterations = iterations
        self._margin = 0.02

    def solve(self, T_world_left: Array, T_world_right: Array, q_start: Array) -> Array:
        """Return q (14,) [rad] with both tool centre points at the given poses (4, 4), found from q_start.

        Raises:
            UsageError: A pose is out of reach or only reached outside the joint limits.
        """
        goals = (T_world_left, T_world_right)
        lower, upper = Q_LOWER + self._margin, Q_UPPER - self._margin
        q = q_start.copy()
        identity = np.eye(DOF_PER_ARM)
        for _ in range(self._iterations):
            errors, J = self._linearise(q, goals)
            # Damped a little, so that a stretched arm slows down instead of lashing out.
            weighted = J * self._mobility
            gram = weighted @ J.transpose(0, 2, 1) + 1e-9 * np.eye(6)
            pinv = np.linalg.solve(gram, weighted).transpose(0, 2, 1)
            reach = (pinv @ errors[:, :, None])[:, :, 0]
            wish = self._posture - q.reshape(2, DOF_PER_ARM)
            stay = ((identity - pinv @ J) @ wish[:, :, None])[:, :, 0]
            if np.abs(errors).max() < self._tolerance and np.abs(stay).max() < self._posture_tolerance:
                return q
            step = np.clip((reach + stay).ravel(), -0.2, 0.2)
            q = np.clip(q + step, lower, upper)
        worst = int(np.argmax(np.abs(errors).max(axis=1)))
        if np.abs(errors).max() < 1e-4:
            return q  # the posture oscillates within its tolerance or rests on a joint limit; the hands are there
        raise UsageError(
            f"the {ARMS[worst]} hand cannot reach position {np.round(goals[worst][:3, 3], 3).tolist()} m: "
            f"{np.abs(errors[worst]).max():.4f} (m or rad) remain",
            remedy="keep the rod within reach: smaller start range, or a start nearer to the arms",
        )

    def _linearise(self, q: Array, goals: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return pose errors (2, 6) and Jacobians (2, 6, 7), world-aligned."""
        left, right = self._kinematics.tcp_jacobians(q)
        J = np.stack([left[:, :DOF_PER_ARM], right[:, DOF_PER_ARM:]])
        errors = np.empty((2, 6))
        for arm, goal in enumerate(goals):
            placement = self._kinematics.data.oMf[self._kinematics.tcp_ids[arm]]
            errors[arm, :3] = goal[:3, 3] - placement.translation
            errors[arm, 3:] = rotation_log(goal[:3, :3] @ placement.rotation.T)
        return errors, J
