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
from scipy.linalg.lapack import dposv

from minidual.control.grasp import GraspMap
from minidual.control.joint_control import JointFriction, within_motors
from minidual.errors import MinidualError
from minidual.robot.constants import DOF, GROUPS, Array
from minidual.robot.kinematics import HandMotion, Kinematics
from minidual.robot.vectors import (
    ZERO,
    Matrix,
    Vector,
    apply,
    apply_transposed,
    cross,
    minus,
    parts,
    plus,
    rotation_error,
    times,
)

GRAVITY = np.array([0.0, 0.0, -9.81])
_G = 9.81
_ARMS = (GROUPS["left_arm"], GROUPS["right_arm"])


class SingularPostureError(MinidualError):
    """An arm is stretched so far that its hand cannot be accelerated in every direction."""


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
        friction: Joint friction that is cancelled; the model's by default.
    """

    def __init__(
        self, kinematics: Kinematics, held: HeldObject, gains: ImpedanceGains,
        friction: JointFriction | None = None,
    ) -> None:  # fmt: skip
        self._model, self._data = kinematics.model, kinematics.data
        self._kinematics = kinematics
        self.held, self.gains = held, gains
        self._K = list(gains.stiffness)
        self._D = [0.0] * 6
        self._inertia: list[list[float]] = held.inertia_kg_m2.tolist()
        self._axis: list[float] = held.axis.tolist()
        self._mass_kg = held.mass_kg
        self._R_hand_object = tuple(np.array(T[:3, :3].T) for T in held.T_object_tcps)

        # Generalised forces of the hands and of viscous friction in one product: [J; diag d]^T [f; v].
        self._friction = JointFriction() if friction is None else friction
        self._is_dry = self._friction.is_dry
        stacked = np.vstack([np.zeros((12, DOF)), np.diag(self._friction.viscous)])
        self._to_joints, self._J = stacked.T, stacked[:12]
        # f (12), v (14) and q* - q (14) side by side, so that v is written once for both products that take it.
        rows = np.zeros(12 + 2 * DOF)
        self._f, self._v, self._away = rows[:12], rows[12 : 12 + DOF], rows[12 + DOF :]
        self._pushes, self._posture_error = rows[: 12 + DOF], rows[12:].reshape(2, DOF)
        self._hands = HandMotion(kinematics, self._J)

        self._posture = np.zeros(DOF)
        self._posture_gains = np.array([-gains.posture_damping_per_s, gains.posture_stiffness_per_s2])

    def engage(self, q: Array) -> None:
        """Take over at posture q (14,): the damping and the null-space posture follow from it."""
        self._posture = np.array(q)
        M = self._kinematics.mass_matrix(q)
        moving = np.zeros(6)
        moving[:3] = self.held.mass_kg
        moving[3:] = np.diag(self.held.inertia_kg_m2)
        lever = max(float(np.linalg.norm(T[:3, 3])) for T in self.held.T_object_tcps)
        for J, arm in zip(self._kinematics.tcp_jacobians(q), _ARMS, strict=True):
            mass_at_hand = np.linalg.inv(J[:3, arm] @ np.linalg.solve(M[arm, arm], J[:3, arm].T))
            moving[:3] += np.diag(mass_at_hand)
            moving[3:] += lever**2 * float(np.mean(np.diag(mass_at_hand)))
        self._D = (2.0 * self.gains.damping_ratio * np.sqrt(self._K * moving)).tolist()

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
        hands = self._hands
        # Posture first: what the hands would feel of it is taken out again by `_least_acceleration`.
        np.subtract(self._posture, q, self._away)
        self._v[:] = v
        posture = self._posture_gains.dot(self._posture_error)
        hands.update(q, v, posture)

        R, p = parts(measured.T_world_object)
        wanted = _Wanted(desired)
        r_left, r_right = minus(hands.p[0].tolist(), p), minus(hands.p[1].tolist(), p)
        squeeze = self._squeeze(internal_force_n, measured_internal_force_n)
        f = GraspMap(r_left, r_right).hand_wrenches(
            *self._object_wrench(R, p, wanted, (desired.twist - measured.twist).tolist()),
            times(squeeze, apply(R, self._axis)),
        )
        self._f[:] = self._hold_hands(f, wanted, self._J.dot(v).tolist())

        qdd = self._least_acceleration(r_left, r_right, wanted)
        qdd += posture
        tau = pin.rnea(self._model, self._data, q, v, qdd)
        tau += self._to_joints.dot(self._pushes)
        if self._is_dry:
            tau += self._friction.dry_torque(v)
        return within_motors(tau)

    def _squeeze(self, wanted_n: float, measured_n: float) -> float:
        """Return F: the wanted squeeze, corrected within its bounds, never a pull and never over the ceiling."""
        limit = self.gains.force_correction_max_n
        correction = min(limit, max(-limit, self.gains.force_gain * (wanted_n - measured_n)))
        return min(self.gains.force_ceiling_n, max(0.0, wanted_n + correction))

    def _object_wrench(
        self, R: Matrix, p: Vector, wanted: _Wanted, twist_error: list[float]
    ) -> tuple[Vector, Vector]:
        """Return w as (force, moment): spring, damper, and what the object's own mass needs."""
        e1, e2, e3 = minus(wanted.p, p)
        e4, e5, e6 = rotation_error(wanted.R, R)
        k1, k2, k3, k4, k5, k6 = self._K
        d1, d2, d3, d4, d5, d6 = self._D
        v1, v2, v3, v4, v5, v6 = twist_error
        a1, a2, a3 = wanted.a
        m = self._mass_kg
        n1, n2, n3 = self._spin_up(R, wanted) if wanted.turns else ZERO
        return (
            (k1 * e1 + d1 * v1 + m * a1, k2 * e2 + d2 * v2 + m * a2, k3 * e3 + d3 * v3 + m * (a3 + _G)),
            (k4 * e4 + d4 * v4 + n1, k5 * e5 + d5 * v5 + n2, k6 * e6 + d6 * v6 + n3),
        )

    def _spin_up(self, R: Matrix, wanted: _Wanted) -> Vector:
        """Return I_w alpha + omega x I_w omega, formed in the object's own axes, where its inertia is constant."""
        omega, alpha = apply_transposed(R, wanted.omega), apply_transposed(R, wanted.alpha)
        spin = cross(omega, apply(self._inertia, omega))
        return apply(R, plus(apply(self._inertia, alpha), spin))

    def _hold_hands(self, f: list[float], wanted: _Wanted, twists: list[float]) -> list[float]:
        """Add to f (12), and return it, the torsional springs that hold the hands to their grasp frames."""
        k, d = self.gains.hand_stiffness_nm_per_rad, self.gains.hand_damping_nms_per_rad
        w1, w2, w3 = wanted.omega
        for i, at in enumerate((3, 9)):
            # How the object would lie if it had not turned in this hand.
            R_object = self._hands.R[i].dot(self._R_hand_object[i]).tolist()
            e1, e2, e3 = rotation_error(wanted.R, R_object)
            f[at] += k * e1 + d * (w1 - twists[at])
            f[at + 1] += k * e2 + d * (w2 - twists[at + 1])
            f[at + 2] += k * e3 + d * (w3 - twists[at + 2])
        return f

    def _least_acceleration(self, r_left: Vector, r_right: Vector, wanted: _Wanted) -> Array:
        """Return the least joint acceleration (14,) that adds to the posture's what the hands lack.

        Adding J^+ (a_hand - J qdd_posture - Jdot v) leaves of the posture motion its part in the null space of J.
        """
        alpha = wanted.alpha
        lacking = np.array((*wanted.a_at(r_left), *alpha, *wanted.a_at(r_right), *alpha))
        lacking -= self._hands.acceleration
        J = self._J
        # Cholesky: J J^T is symmetric, so its transpose is itself in the order of memory that LAPACK works in.
        _, y, failed = dposv(J.dot(J.T).T, lacking, overwrite_a=True, overwrite_b=True)
        if failed:
            raise SingularPostureError(
                "a hand has lost a direction of motion: J J^T is singular",
                remedy="keep the elbows bent: a stretched arm cannot carry",
            )
        return J.T.dot(y)


class _Wanted:
    """An `ObjectState` in plain floats. A straight path does not turn, and its terms of rotation are not formed."""

    __slots__ = ("R", "a", "alpha", "omega", "p", "turns")

    def __init__(self, state: ObjectState) -> None:
        self.R, self.p = parts(state.T_world_object)
        _, _, _, w1, w2, w3 = state.twist.tolist()
        a1, a2, a3, b1, b2, b3 = state.acceleration.tolist()
        self.omega, self.a, self.alpha = (w1, w2, w3), (a1, a2, a3), (b1, b2, b3)
        self.turns = self.omega != ZERO or self.alpha != ZERO

    def a_at(self, r: Vector) -> Vector:
        """Return the acceleration of the object's point at r from its centre: a + alpha x r + omega x (omega x r)."""
        if not self.turns:
            return self.a
        return plus(self.a, plus(cross(self.alpha, r), cross(self.omega, cross(self.omega, r))))
