"""Object impedance: the held object behaves like a damped spring; the squeeze is servoed.

    e     = [p_d - p; log(R_d R^T)]                                  pose error, world axes
    w     = K e + D (V_d - V) + [m (a_d - g); I_w alpha_d + omega_d x I_w omega_d],  I_w = R I_o R^T
    F     = sat_[0, 80](F_d + sat_15(k_int (F_d - F_measured)))      squeeze
    f     = G^+ w + (I - G^+ G) f_int(F)                             hand wrenches
    tau_i = M qdd_ff + h + J_i^T f_i + friction,  J qdd_ff = a_hand - Jdot v

D = 2 zeta sqrt(K M_eff), M_eff including the arms. Torsional springs hold the hands to the grasp, since opposed
pads let them pivot. Sources: Schneider and Cannon 1992; Caccavale et al. 2008; docs/force-control.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from minidual.control import kernels
from minidual.control.joint_control import JointFriction
from minidual.errors import MinidualError
from minidual.robot.kinematics import HandMotion, Kinematics
from minidual.robot.pair import SIDES, Array

GRAVITY = np.array([0.0, 0.0, -9.81])
_BENT = "keep the elbows bent: a stretched arm cannot carry"


def bounded(value: float, low: float, high: float) -> float:
    """Return the value clipped; NaN stays NaN."""
    return high if value > high else low if value < low else value


class SingularPostureError(MinidualError):
    """A stretched arm's hand cannot accelerate in every direction."""


@dataclass(frozen=True)
class ObjectState:
    """Object pose (4, 4), twist (6,) and acceleration (6,) at its centre of mass, world axes."""

    T_world_object: Array
    twist: Array = field(default_factory=lambda: np.zeros(6))
    acceleration: Array = field(default_factory=lambda: np.zeros(6))


@dataclass(frozen=True)
class HeldObject:
    """Object data.

    Attributes:
        inertia_kg_m2: (3, 3) about the centre of mass, object axes.
        T_object_tcps: Left, right.
        axis: (3,) unit vector, object axes, from right to left hand.
    """

    mass_kg: float
    inertia_kg_m2: Array
    T_object_tcps: tuple[Array, Array]
    axis: Array


@dataclass(frozen=True)
class ImpedanceGains:
    """Gains, by default nominal."""

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
    """The law for one object and grasp."""

    def __init__(
        self, kinematics: Kinematics, held: HeldObject, gains: ImpedanceGains, friction: JointFriction | None = None
    ) -> None:
        self._model, self._data = kinematics.model, kinematics.data
        self._kinematics = kinematics
        robot = kinematics.robot
        self.held, self.gains = held, gains
        friction = JointFriction.of(robot) if friction is None else friction

        self._law = np.zeros(1, kernels.LAW)
        known = kernels.view(self._law)
        self._rows = np.zeros((len(kernels.ROWS), robot.dof))
        known |= dict(zip(kernels.ROWS, self._rows, strict=True))
        self._J = np.zeros((12, robot.dof))
        for name, value in {
            "K": gains.stiffness,
            "mass": held.mass_kg,
            "inertia": held.inertia_kg_m2,
            "axis": held.axis,
            "gravity": GRAVITY,
            "R_hand_object": [T[:3, :3].T for T in held.T_object_tcps],
            "hand_stiffness": gains.hand_stiffness_nm_per_rad,
            "hand_damping": gains.hand_damping_nms_per_rad,
            "posture_stiffness": gains.posture_stiffness_per_s2,
            "posture_damping": gains.posture_damping_per_s,
            "viscous": friction.viscous,
            "dry": friction.dry,
            "smooth": friction.smooth_rad_s,
            "tau_max": robot.tau_max,
        }.items():
            known[name][...] = value
        self._D, self._posture, self._squeezed = known["D"], known["posture"], known["squeeze"]
        self._q, self._v = known["q"], known["v"]
        self._T, self._twist = known["T"], known["twist"]
        self._T_d, self._twist_d, self._a_d = known["T_d"], known["twist_d"], known["a_d"]
        self._qdd_posture, self._qdd = known["qdd_posture"], known["qdd"]
        self._hands = HandMotion(kinematics, self._J, known["a_hands"])

    def engage(self, q: Array) -> None:
        """Set damping and null-space posture from q (n,).

        Raises:
            SingularPostureError: A hand lost a direction of motion.
        """
        self._posture[:] = q
        M = self._kinematics.mass_matrix(q)
        moving = np.zeros(6)
        moving[:3] = self.held.mass_kg
        moving[3:] = np.diag(self.held.inertia_kg_m2)
        lever = max(float(np.linalg.norm(T[:3, 3])) for T in self.held.T_object_tcps)
        for index, (name, J) in enumerate(zip(SIDES, self._kinematics.tcp_jacobians(q), strict=True)):
            arm = self._kinematics.robot.joints_of(index)
            try:
                mass_at_hand = np.linalg.inv(J[:3, arm] @ np.linalg.solve(M[arm, arm], J[:3, arm].T))
            except np.linalg.LinAlgError as error:
                raise SingularPostureError(
                    f"the {name} hand has lost a direction of motion: J M^-1 J^T is singular", remedy=_BENT
                ) from error
            moving[:3] += np.diag(mass_at_hand)
            moving[3:] += lever**2 * float(np.mean(np.diag(mass_at_hand)))
        self._D[:] = 2.0 * self.gains.damping_ratio * np.sqrt(self.gains.stiffness * moving)

    def torque(
        self,
        q: Array,
        v: Array,
        measured: ObjectState,
        desired: ObjectState,
        *,
        internal_force_n: float,
        measured_internal_force_n: float,
    ) -> Array:
        """Return motor torques (n,) [Nm], clipped to the limits.

        The measured internal force must come from the contacts, never from the hands' distance.

        Raises:
            SingularPostureError: A hand lost a direction of motion.
        """
        law, rows, hands = self._law, self._rows, self._hands
        self._q[:], self._v[:] = q, v
        self._T[:], self._twist[:] = measured.T_world_object, measured.twist
        self._T_d[:], self._twist_d[:], self._a_d[:] = (desired.T_world_object, desired.twist, desired.acceleration)
        self._squeezed[0] = self._squeeze(internal_force_n, measured_internal_force_n)

        # Posture first: the least-norm correction then cancels its effect on the hands.
        kernels.posture_acceleration(law, rows)
        hands.update(self._q, self._v, self._qdd_posture)
        if not kernels.impedance(law, rows, self._J, *hands.p, *hands.R):
            raise SingularPostureError("a hand has lost a direction of motion: J J^T is singular", remedy=_BENT)
        tau = pin.rnea(self._model, self._data, self._q, self._v, self._qdd)
        kernels.add_push(law, rows, tau)
        return tau

    def _squeeze(self, wanted_n: float, measured_n: float) -> float:
        """Return F [N]."""
        limit = self.gains.force_correction_max_n
        correction = bounded(self.gains.force_gain * (wanted_n - measured_n), -limit, limit)
        return bounded(wanted_n + correction, 0.0, self.gains.force_ceiling_n)
