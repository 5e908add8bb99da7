"""Object impedance: two arms hold one object, its pose behaves like a damped spring, its squeeze is servoed.

    e     = [ p_d - p ; log(R_d R^T) ]                                   pose error, world axes
    w     = K e + D (V_d - V) + [ m (a_d - g) ; I_w alpha_d + omega x I_w omega ],   I_w = R I_o R^T
    F     = sat_[0, 80] ( F_d + sat_15 ( k_int (F_d - F_measured) ) )    squeeze along the object's own axis
    f     = G^+ w + (I - G^+ G) f_int(F)                                 hand wrenches on the object
    tau_i = M qdd_ff + h + J_i^T f_i + d v,     J qdd_ff = a_hand - Jdot v

f_i is the wrench of the hand on the object, so the arm adds +J_i^T f_i. The damping D = 2 zeta sqrt(K M_eff)
takes the mass that really moves: the object's and both arms' at their hands, since impedance control without
inertia shaping leaves the arms' inertia in the loop. Each hand's orientation is held to its grasp frame by a
small torsional spring, because two opposed finger pads leave it free to pivot about the pinch axis.

Sources: Schneider and Cannon 1992 (object impedance); Caccavale et al. 2008 (internal and external forces);
Siciliano and Khatib, Springer Handbook of Robotics, ch. 30.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from minidual.control.grasp import GraspMap, squeeze_reference
from minidual.robot.constants import DOF, GROUPS, JOINT_DAMPING, TAU_MAX, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import rotation_log

GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True)
class ObjectState:
    """Motion of the held object: pose (4, 4), twist (6,) and acceleration (6,) at its centre of mass, world axes."""

    T_world_object: Array
    twist: Array = field(default_factory=lambda: np.zeros(6))
    acceleration: Array = field(default_factory=lambda: np.zeros(6))


@dataclass(frozen=True)
class HeldObject:
    """What the law must know of the object.

    Attributes:
        mass_kg: Mass.
        inertia_kg_m2: (3, 3) about the centre of mass, object axes.
        T_object_tcps: (T_object_left_tcp, T_object_right_tcp), the grasp.
        axis: (3,) unit vector in object axes from the right to the left hand.
    """

    mass_kg: float
    inertia_kg_m2: Array
    T_object_tcps: tuple[Array, Array]
    axis: Array


@dataclass(frozen=True)
class ImpedanceGains:
    """Gains of the law; defaults are the nominal ones."""

    stiffness: tuple[float, ...] = (500.0, 500.0, 500.0, 20.0, 20.0, 20.0)
    damping_ratio: float = 1.0
    internal_force_n: float = 40.0
    force_gain: float = 0.5
    force_correction_max_n: float = 15.0
    force_ceiling_n: float = 80.0
    hand_stiffness_nm_per_rad: float = 30.0
    hand_damping_nms_per_rad: float = 2.0
    posture_stiffness_per_s2: float = 20.0
    posture_damping_per_s: float = 9.0


class ObjectImpedance:
    """The law above for two arms; one instance per object and grasp.

    Args:
        kinematics: Workspace for kinematics and dynamics.
        held: Object and grasp.
        gains: Gains.
    """

    def __init__(self, kinematics: Kinematics, held: HeldObject, gains: ImpedanceGains) -> None:
        self._model, self._data = kinematics.model, kinematics.data
        self._tcps = kinematics.tcp_ids
        self.held, self.gains = held, gains
        self._K = np.array(gains.stiffness)
        self._D = np.zeros(6)
        self._posture = np.zeros(DOF)
        self._arms = (GROUPS["left_arm"], GROUPS["right_arm"])

    def engage(self, q: Array) -> None:
        """Take over at posture q (14,): the damping and the null-space posture follow from it."""
        self._posture = np.array(q)
        pin.computeJointJacobians(self._model, self._data, q)
        pin.updateFramePlacements(self._model, self._data)
        M = pin.crba(self._model, self._data, q)
        M = np.triu(M) + np.triu(M, 1).T
        moving = np.zeros(6)
        moving[:3] = self.held.mass_kg
        moving[3:] = np.diag(self.held.inertia_kg_m2)
        lever = max(float(np.linalg.norm(T[:3, 3])) for T in self.held.T_object_tcps)
        for tcp, arm in zip(self._tcps, self._arms, strict=True):
            J = pin.getFrameJacobian(self._model, self._data, tcp, pin.LOCAL_WORLD_ALIGNED)[:, arm]
            mass_at_hand = np.linalg.inv(J[:3] @ np.linalg.solve(M[arm, arm], J[:3].T))
            moving[:3] += np.diag(mass_at_hand)
            moving[3:] += lever**2 * float(np.mean(np.diag(mass_at_hand)))
        self._D = 2.0 * self.gains.damping_ratio * np.sqrt(self._K * moving)

    def torque(
        self, q: Array, v: Array, measured: ObjectState, desired: ObjectState, *,
        internal_force_n: float, measured_internal_force_n: float,
    ) -> Array:  # fmt: skip
        """Return motor torques (14,) [Nm], clipped to the motors' limits.

        Args:
            q: Joint positions (14,) [rad].
            v: Joint velocities (14,) [rad/s].
            measured: Object as sensed (its acceleration is not used).
            desired: Object as wanted.
            internal_force_n: Squeeze wanted [N].
            measured_internal_force_n: Squeeze sensed at the contacts [N]; never taken from the hands' distance.
        """
        model, data, gains = self._model, self._data, self.gains
        zero = np.zeros(DOF)
        pin.forwardKinematics(model, data, q, v, zero)
        pin.computeJointJacobians(model, data)
        pin.updateFramePlacements(model, data)
        T_object, T_desired = measured.T_world_object, desired.T_world_object
        R, p = T_object[:3, :3], T_object[:3, 3]

        frames = [data.oMf[tcp] for tcp in self._tcps]
        grasp = GraspMap(frames[0].translation - p, frames[1].translation - p)
        squeeze = self._squeeze(internal_force_n, measured_internal_force_n)
        f = grasp.distribute(
            self._object_wrench(R, p, T_desired, measured, desired),
            squeeze_reference(R @ self.held.axis, squeeze),
        )

        qdd = np.zeros(DOF)
        external = np.zeros(DOF)
        for i, (tcp, arm) in enumerate(zip(self._tcps, self._arms, strict=True)):
            J = pin.getFrameJacobian(model, data, tcp, pin.LOCAL_WORLD_ALIGNED)[:, arm]
            drift = pin.getFrameClassicalAcceleration(model, data, tcp, pin.LOCAL_WORLD_ALIGNED).vector
            r = frames[i].translation - p
            omega, alpha = desired.twist[3:], desired.acceleration[3:]
            a_hand = np.concatenate(
                [desired.acceleration[:3] + np.cross(alpha, r) + np.cross(omega, np.cross(omega, r)), alpha]
            )
            gram = J @ J.T
            posture = (
                gains.posture_stiffness_per_s2 * (self._posture[arm] - q[arm])
                - gains.posture_damping_per_s * v[arm]
            )
            # Least-squares joint acceleration of the hand plus posture motion in the Jacobian's null space.
            qdd[arm] = posture + J.T @ np.linalg.solve(gram, a_hand - drift - J @ posture)
            wrench = f[6 * i : 6 * i + 6].copy()
            R_grasp = T_desired[:3, :3] @ self.held.T_object_tcps[i][:3, :3]
            hand_error = rotation_log(R_grasp @ frames[i].rotation.T)
            hand_rate = omega - J[3:] @ v[arm]
            wrench[3:] += (
                gains.hand_stiffness_nm_per_rad * hand_error + gains.hand_damping_nms_per_rad * hand_rate
            )
            external[arm] = J.T @ wrench
        tau = pin.rnea(model, data, q, v, qdd) + external + JOINT_DAMPING * v
        return np.clip(tau, -TAU_MAX, TAU_MAX)

    def _squeeze(self, wanted_n: float, measured_n: float) -> float:
        limit = self.gains.force_correction_max_n
        correction = min(limit, max(-limit, self.gains.force_gain * (wanted_n - measured_n)))
        return min(self.gains.force_ceiling_n, max(0.0, wanted_n + correction))

    def _object_wrench(
        self, R: Array, p: Array, T_desired: Array, measured: ObjectState, desired: ObjectState
    ) -> Array:
        error = np.concatenate([T_desired[:3, 3] - p, rotation_log(T_desired[:3, :3] @ R.T)])
        w = self._K * error + self._D * (desired.twist - measured.twist)
        inertia = R @ self.held.inertia_kg_m2 @ R.T
        omega = desired.twist[3:]
        w[:3] += self.held.mass_kg * (desired.acceleration[:3] - GRAVITY)
        w[3:] += inertia @ desired.acceleration[3:] + np.cross(omega, inertia @ omega)
        return w
