"""Hand impedance: one hand along a joint reference is a damped spring of bounded force.

Law and sources: docs/hand-impedance.md.
"""

from typing import NamedTuple

import numpy as np

from minidual.control.impedance import inertia_at_hand, lost_direction
from minidual.control.impedance_kernels import HAND_LAW, from_hand, hand_impedance
from minidual.control.joint_control import ComputedTorque, motor_torque
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import Array

STIFFNESS_N_PER_M = 2000.0
STIFFNESS_NM_PER_RAD = 100.0
DAMPING_RATIO = 1.0
FORCE_MAX_N = 10.0
MOMENT_MAX_NM = 1.2
"""Bounds of the spring along and about each axis: beyond the dry friction of a joint."""
_LEARNING_PER_S = 4.0
_ELBOW_STIFFNESS_PER_S2 = 100.0
_ELBOW_DAMPING_PER_S = 20.0
"""Of one hand's null space: dry friction of 0.5 Nm holds an elbow off by 0.03 to 0.04 rad (0.1 with 20 and 9)."""
_HEAVIEST = 20.0
"""Largest inertia [kg, kg m^2] of a hand that damping is made for: near a singularity it is hundreds, and soon past."""
_NO_SHIFT = (0.0, 0.0, 0.0)
_AT_TCP = np.eye(4)
_AT_TCP.setflags(write=False)


class InHand(NamedTuple):
    """What a hand holds.

    Attributes:
        name: Of the object; empty for nothing.
        T_tcp_object: (4, 4).
        T_tcp_planned: The same in the plan that gave the joint reference.
        centre_m: (3,) centre of compliance, object axes.
    """

    name: str = ""
    T_tcp_object: Array = _AT_TCP
    T_tcp_planned: Array = _AT_TCP
    centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


class HandImpedance(ComputedTorque):
    """The law of one hand."""

    def __init__(self, kinematics: Kinematics, arm: int, dt_s: float) -> None:
        super().__init__(kinematics)
        self._arm = arm
        self._joints = kinematics.robot.joints_of(arm)
        self._hands = Hands(kinematics)
        self.held = InHand()
        self._held = InHand()
        self.other: InHand | None = None
        """What the other hand holds, if the reference moves with it; both from the next engagement on."""
        self._other = self.other
        self.shift_m = _NO_SHIFT
        """The reference is moved by so much along the object's axes."""
        K, most = np.repeat(
            [[STIFFNESS_N_PER_M, STIFFNESS_NM_PER_RAD], [FORCE_MAX_N, MOMENT_MAX_NM]],
            3,
            axis=1,
        )
        posture = _ELBOW_STIFFNESS_PER_S2, _ELBOW_DAMPING_PER_S
        own = K, most, np.zeros((6, 6)), np.zeros(3), _AT_TCP, _LEARNING_PER_S * dt_s, *posture
        self._law = np.array([own], HAND_LAW)
        self._learnt = np.zeros(6)

    def engage(self, q: Array) -> None:
        """Set the damping from q (n,), and forget what was learnt."""
        held = self._held = self.held
        self._other = self.other
        self.shift_m = _NO_SHIFT
        self._learnt = np.zeros(6)
        T, J = self._placed(q)
        M = self._kinematics.mass_matrix(q)[self._joints, self._joints]
        axes = np.kron(np.eye(2), T[:3, :3])
        squares, modes = np.linalg.eigh(axes.T @ inertia_at_hand(M, J, self._arm) @ axes)
        half = (
            (modes * np.sqrt(np.minimum(squares, _HEAVIEST))) @ modes.T * np.sqrt(self._law["K"][0])
        )
        self._law["D"], self._law["centre"] = DAMPING_RATIO * (half + half.T), held.centre_m
        self._law["T_tcp_object"] = held.T_tcp_object

    def correct(self, held: InHand, other: InHand | None) -> None:
        """Take another estimate of what both hands hold; damping and what was learnt stay."""
        self._held = self.held = held
        self._other = self.other = other
        self._law["T_tcp_object"] = held.T_tcp_object

    def lag(self, q: Array, q_ref: Array) -> Array:
        """Return how far the object is behind its reference (3,) [m], in the reference's axes.

        The reference counts as it is planned, not shifted.
        """
        T_ref = self._wanted(q, q_ref)
        T = np.empty((4, 4))
        held = self._held.T_tcp_object
        from_hand(self._hands.views, self._arm, held, _AT_TCP, False, T)
        return T_ref[:3, :3].T @ (T_ref[:3, 3] - T[:3, 3])

    def torque(
        self,
        q: Array,
        v: Array,
        q_ref: Array,
        v_ref: Array,
        a_ref: Array,
        load: Array | None = None,
    ) -> Array:
        """See `ComputedTorque`; of its own arm, or raise SingularPostureError."""
        T_ref = self._wanted(q, q_ref)
        if any(self.shift_m):
            T_ref[:3, 3] += T_ref[:3, :3] @ self.shift_m
        qdd = a_ref.copy()
        push = np.zeros(len(q)) if load is None else load.copy()
        of_hand = self._law, self._hands.views, self._arm, T_ref
        if not hand_impedance(*of_hand, q, v, q_ref, v_ref, self._learnt, qdd, push):
            raise lost_direction(self._arm)
        return motor_torque(self._kinematics, q, v, qdd, push)

    def _wanted(self, q: Array, q_ref: Array) -> Array:
        """Return the object's pose (4, 4) that the reference asks for, and update the hands."""
        hands = self._hands
        away = 1 - self._arm
        T = np.empty((4, 4))
        T_away = np.empty((4, 4))
        hands.place(q_ref)
        from_hand(hands.views, self._arm, self._held.T_tcp_planned, _AT_TCP, False, T)
        if self._other is not None:
            from_hand(hands.views, away, self._other.T_tcp_planned, T, True, T_away)
        hands.update(q)
        if self._other is not None:
            from_hand(hands.views, away, self._other.T_tcp_object, T_away, False, T)
        return T

    def _placed(self, q: Array) -> tuple[Array, Array]:
        """Return the object's pose (4, 4) and the Jacobian (6, n) at the centre of compliance."""
        J = self._kinematics.tcp_jacobians(q)[self._arm][:, self._joints].copy()
        T_tcp = self._kinematics.data.oMf[self._kinematics.tcp_ids[self._arm]].homogeneous
        T = T_tcp @ self._held.T_tcp_object
        x, y, z = T[:3, 3] + T[:3, :3] @ self._held.centre_m - T_tcp[:3, 3]
        J[:3] -= np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ J[3:]
        return T, J
