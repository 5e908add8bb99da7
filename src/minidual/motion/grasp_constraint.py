"""The constraint of a closed chain: two hands that hold one object keep their relative pose.

With E(q) = T_world_left^-1 T_world_right T_left_right^-1, the constraint is F(q) = log6(E), six numbers [linear;
angular] in the frame of the left hand, zero where the hands stand to each other as they grasped. The body velocity of
E is Ad(T_left_right) J_right dq - Ad(E^-1) J_left dq with the hands' Jacobians in their own frames, so

    dF/dq = Jlog6(E) [ -Ad(E^-1) J_left,  Ad(T_left_right) J_right ]

(Sola, "A micro Lie theory for state estimation in robotics", 2018: adjoints and the right Jacobian of the log).
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from minidual.collision.errors import ClosedChainError
from minidual.motion.ik import check_pose
from minidual.robot.constants import Q_LOWER, Q_UPPER, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import inverse

TOLERANCE = 1e-9
"""Norm of F [m and rad together] at which a projected configuration counts as on the manifold."""
_ITERATIONS = 30
_DAMPING = 1e-9


class GraspConstraint:
    """F(q) = 0 keeps the right hand at T_left_right in the frame of the left one.

    Args:
        T_left_right: Pose (4, 4) of the right tcp in the left tcp.
        kinematics: Workspace; one of its own by default.
    """

    def __init__(self, T_left_right: Array, kinematics: Kinematics | None = None) -> None:
        self.T_left_right = check_pose(T_left_right, "the relative pose of the hands")
        grasp = pin.SE3(self.T_left_right)
        self._inverse = grasp.inverse()
        self._adjoint = grasp.action
        self._kinematics = kinematics or Kinematics()

    @classmethod
    def from_grasps(
        cls, T_object_tcp_left: Array, T_object_tcp_right: Array, kinematics: Kinematics | None = None
    ) -> GraspConstraint:
        """Return the constraint of two hands at their grasps on one object."""
        left = check_pose(T_object_tcp_left, "the left grasp")
        right = check_pose(T_object_tcp_right, "the right grasp")
        return cls(inverse(left) @ right, kinematics)

    def _offset(self) -> pin.SE3:
        """Return E at the joints whose placements the workspace holds."""
        model, data = self._kinematics.model, self._kinematics.data
        left, right = self._kinematics.tcp_ids
        T_left = pin.updateFramePlacement(model, data, left)
        T_right = pin.updateFramePlacement(model, data, right)
        return T_left.actInv(T_right) * self._inverse

    def value(self, q: Array) -> Array:
        """Return F (6,) at q (14,): metres, then radians."""
        pin.forwardKinematics(self._kinematics.model, self._kinematics.data, q)
        return pin.log6(self._offset()).vector

    def jacobian(self, q: Array) -> Array:
        """Return dF/dq (6, 14) at q (14,)."""
        return self.value_and_jacobian(q)[1]

    def value_and_jacobian(self, q: Array) -> tuple[Array, Array]:
        """Return F (6,) and dF/dq (6, 14) at q (14,), one pass over the kinematics."""
        model, data = self._kinematics.model, self._kinematics.data
        left, right = self._kinematics.tcp_ids
        pin.computeJointJacobians(model, data, q)
        E = self._offset()
        J_left = pin.getFrameJacobian(model, data, left, pin.LOCAL)
        J_right = pin.getFrameJacobian(model, data, right, pin.LOCAL)
        J = pin.Jlog6(E) @ (self._adjoint @ J_right - E.actionInverse @ J_left)
        return pin.log6(E).vector, J

    def residual(self, q: Array) -> tuple[float, float]:
        """Return how far the hands are from their grasp at q (14,): ([m], [rad])."""
        pin.forwardKinematics(self._kinematics.model, self._kinematics.data, q)
        E = self._offset()
        return float(np.linalg.norm(E.translation)), float(np.linalg.norm(pin.log3(E.rotation)))

    def project(self, q: Array, tolerance: float = TOLERANCE) -> Array | None:
        """Return the configuration (14,) near q on the manifold, inside the joint limits, or None.

        Newton steps of least norm, q <- q - J^T (J J^T)^-1 F; a joint that a step would push over its limit stays
        there and the others make up for it.
        """
        q = np.clip(np.asarray(q, dtype=float), Q_LOWER, Q_UPPER)
        for _ in range(_ITERATIONS):
            F, J = self.value_and_jacobian(q)
            if not np.isfinite(F).all():
                return None
            if tolerance**2 > F @ F:
                return q
            step = _least_norm(J, F)
            over = ((q <= Q_LOWER) & (step < 0.0)) | ((q >= Q_UPPER) & (step > 0.0))
            if over.any():
                step = _least_norm(np.where(over, 0.0, J), F)
            q = np.clip(q + step, Q_LOWER, Q_UPPER)
        return None

    def require(self, q: Array, what: str) -> Array:
        """Return q (14,) projected onto the manifold.

        Raises:
            ClosedChainError: No configuration near q keeps the relative pose; with the residual.
        """
        projected = self.project(q)
        if projected is None:
            distance, angle = self.residual(q)
            raise ClosedChainError(
                f"the {what} cannot keep the relative pose of the hands: they are {distance * 1e3:.2f} mm and "
                f"{angle:.4f} rad from it, and no configuration near it inside the joint limits mends that",
                remedy="take the grasps from the hands as they are (grasp_of), or choose another configuration",
            )
        return projected


def _least_norm(J: Array, F: Array) -> Array:
    """Return the shortest step (14,) that takes F to zero to first order."""
    H = J @ J.T
    H.flat[:: len(H) + 1] += _DAMPING
    return -J.T @ np.linalg.solve(H, F)
