"""Impedance of one hand along a joint reference: a damped spring of bounded force (docs/force-control.md)."""

from typing import NamedTuple

import numpy as np

from minidual.control.controllers import JointTrajectoryController, Payload
from minidual.control.joint_control import ComputedTorque
from minidual.control.object_impedance import (
    POSTURE_DAMPING_PER_S,
    POSTURE_STIFFNESS_PER_S2,
    inertia_at_hand,
    lost_direction,
)
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array
from minidual.robot.poses import inverse, rotation_log

STIFFNESS_N_PER_M, STIFFNESS_NM_PER_RAD, DAMPING_RATIO = 2000.0, 100.0, 1.0
FORCE_MAX_N, MOMENT_MAX_NM = 10.0, 1.2
"""Bounds of the spring along and about each axis: beyond the dry friction of a joint."""
_LEARNING_PER_S = 4.0
_UP = np.array([0.0, 0.0, 9.81])
_AT_TCP = np.eye(4)
_AT_TCP.setflags(write=False)


class InHand(NamedTuple):
    """What a hand holds.

    Attributes:
        name: Of the object; empty for nothing.
        T_tcp_object: (4, 4).
        T_tcp_planned: The same in the plan that gave the joint reference.
        mass_kg: Of the object.
        centre_m: (3,) centre of compliance, object axes.
    """

    name: str = ""
    T_tcp_object: Array = _AT_TCP
    T_tcp_planned: Array = _AT_TCP
    mass_kg: float = 0.0
    centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


class HandImpedance(ComputedTorque):
    """The law of one hand."""

    def __init__(self, kinematics: Kinematics, arm: int, dt_s: float) -> None:
        super().__init__(kinematics)
        self._kinematics, self._arm, self._joints = kinematics, arm, kinematics.robot.joints_of(arm)
        self._learning, self._most = _LEARNING_PER_S * dt_s, np.repeat([FORCE_MAX_N, MOMENT_MAX_NM], 3)
        self.held, self._held = InHand(), InHand()
        self.other: InHand | None = None
        """What the other hand holds, if the reference moves with it; both from the next engagement on."""
        self._other = self.other
        self._K = np.repeat([STIFFNESS_N_PER_M, STIFFNESS_NM_PER_RAD], 3)
        self._D, self._learnt = np.zeros((6, 6)), np.zeros(6)

    def engage(self, q: Array) -> None:
        """Set the damping from q (n,), and forget what was learnt."""
        self._held, self._other = self.held, self.other
        T, J = self._placed(q)
        M = self._kinematics.mass_matrix(q)[self._joints, self._joints]
        axes = np.kron(np.eye(2), T[:3, :3])
        squares, modes = np.linalg.eigh(axes.T @ inertia_at_hand(M, J, self._arm) @ axes)
        half = (modes * np.sqrt(squares)) @ modes.T * np.sqrt(self._K)
        self._D = DAMPING_RATIO * (half + half.T)
        self._learnt = np.zeros(6)

    def torque(self, q: Array, v: Array, q_ref: Array, v_ref: Array, a_ref: Array, load: Array | None = None) -> Array:
        """See `ComputedTorque`; of its own arm, or raise SingularPostureError."""
        held, own = self._held, self._joints
        T_ref = self._wanted(q, q_ref)
        T, J = self._placed(q)
        axes, lever = T_ref[:3, :3], T[:3, :3] @ held.centre_m
        away = T_ref[:3, 3] + axes @ held.centre_m - T[:3, 3] - lever
        pull = self._K * np.r_[away @ axes, rotation_log(axes @ T[:3, :3].T) @ axes]
        late = J @ (v_ref - v)[own]
        self._learnt = np.clip(self._learnt + self._learning * pull, -self._most, self._most)
        f = np.clip(pull + self._learnt, -self._most, self._most) + self._D @ np.r_[late[:3] @ axes, late[3:] @ axes]
        weight = (held.mass_kg if load is None else 0.0) * _UP  # else learnt while it was held
        wrench = np.r_[axes @ f[:3] + weight, axes @ f[3:] - np.cross(lever, weight)]
        posture = POSTURE_STIFFNESS_PER_S2 * (q_ref - q)[own] + POSTURE_DAMPING_PER_S * (v_ref - v)[own]
        try:
            within = posture - J.T @ np.linalg.solve(J @ J.T, J @ posture)
        except np.linalg.LinAlgError as error:
            raise lost_direction(self._arm) from error
        qdd, push = a_ref.copy(), np.zeros_like(q) if load is None else load.copy()
        qdd[own] += within
        push[own] += J.T @ wrench
        return self._motors.torque(q, v, qdd, push)

    def _wanted(self, q: Array, q_ref: Array) -> Array:
        tips = self._kinematics.tcp_poses(q_ref)
        T = tips[self._arm] @ self._held.T_tcp_planned
        if self._other is None:
            return T
        planned = tips[1 - self._arm] @ self._other.T_tcp_planned
        return self._kinematics.tcp_poses(q)[1 - self._arm] @ self._other.T_tcp_object @ inverse(planned) @ T

    def _placed(self, q: Array) -> tuple[Array, Array]:
        """Return the object's pose (4, 4) and the Jacobian (6, n) at the centre of compliance."""
        J = self._kinematics.tcp_jacobians(q)[self._arm][:, self._joints].copy()
        T_tcp = self._kinematics.data.oMf[self._kinematics.tcp_ids[self._arm]].homogeneous
        T = T_tcp @ self._held.T_tcp_object
        x, y, z = T[:3, 3] + T[:3, :3] @ self._held.centre_m - T_tcp[:3, 3]
        J[:3] -= np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ J[3:]
        return T, J


class HandImpedanceController(JointTrajectoryController):
    """Does what `left_arm` or `right_arm` does, by impedance."""

    def __init__(self, arm: int, kinematics: Kinematics, dt_s: float, payload: Payload) -> None:
        super().__init__(f"{SIDES[arm]}_arm", kinematics, dt_s, payload)
        self.name = f"{SIDES[arm]}_hand"
        self._servo = self.law = HandImpedance(kinematics, arm, dt_s)

    def activate(self, q: Array, v: Array) -> None:
        """Start the reference at the measurement."""
        super().activate(q, v)
        self.law.engage(q)
