"""Computed-torque control of all 14 joints: gains follow from the inertia seen at each joint.

    tau = M(q) [ a_ref + 2 zeta wn (v_ref - v) + wn^2 (q_ref - q) ] + h(q, v) + d v

Multiplying by the joint-space inertia M gives every joint the same closed-loop natural frequency wn whatever
inertia it carries; a shoulder sees more than ten times the inertia of a wrist, so one number for all would leave
the shoulder slack and the wrist shaking (the table: `python -m minidual.control.joint_gains`). h holds Coriolis,
centrifugal and gravity torques, d the joint friction. Source: Siciliano et al., Robotics, ch. 8.5.2 (inverse dynamics
control).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy import subtract

from minidual.robot.constants import DOF, JOINT_DAMPING, JOINT_FRICTION, TAU_MAX, Array
from minidual.robot.kinematics import Kinematics


@dataclass(frozen=True)
class JointFriction:
    """Friction that the controllers cancel: d v + c tanh(v / v_s).

    The tangent hyperbolic stands for the sign: within v_s of rest the sign of a measured velocity is noise. So dry
    friction is not cancelled at rest, where nobody can tell which way it points.

    Attributes:
        viscous: d (14,) [Nm s/rad]; the model's own by default.
        dry: c (14,) [Nm]; the model's own by default.
        smooth_rad_s: v_s.
    """

    viscous: Array = field(default_factory=lambda: np.full(DOF, JOINT_DAMPING))
    dry: Array = field(default_factory=lambda: np.full(DOF, JOINT_FRICTION))
    smooth_rad_s: float = 0.02

    @property
    def is_dry(self) -> bool:
        """Return whether any joint has dry friction: without it the term is not worth its time."""
        return bool(self.dry.any())

    def dry_torque(self, v: Array) -> Array:
        """Return c tanh(v / v_s) (14,) [Nm]."""
        return self.dry * np.tanh(v / self.smooth_rad_s)


class ComputedTorque:
    """Tracks joint references of both arms.

    Args:
        kinematics: Workspace for the dynamics.
        natural_frequency_rad_s: wn, the same for all joints.
        damping_ratio: zeta.
        friction: What is cancelled; the model's by default.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        *,
        natural_frequency_rad_s: float = 20.0,
        damping_ratio: float = 1.0,
        friction: JointFriction | None = None,
    ) -> None:
        from minidual.control.kernels import add_friction  # compiled: importing it is not free

        self._add_friction = add_friction
        self._model, self._data = kinematics.model, kinematics.data
        self._gains = np.array([natural_frequency_rad_s**2, 2.0 * damping_ratio * natural_frequency_rad_s, 1.0])
        self._friction = JointFriction() if friction is None else friction
        self._joints = np.array([self._friction.viscous, self._friction.dry, TAU_MAX])
        self._v = np.zeros(DOF)
        self._errors = np.zeros((3, DOF))  # rows: position, velocity, acceleration
        self._e, self._de, self._dde = self._errors

    def torque(self, q: Array, v: Array, q_ref: Array, v_ref: Array, a_ref: Array) -> Array:
        """Return motor torques (14,) [Nm], clipped to the motors' limits."""
        subtract(q_ref, q, self._e)
        subtract(v_ref, v, self._de)
        self._dde[:] = a_ref
        a = self._gains.dot(self._errors)
        # rnea(q, v, a) = M a + h in one O(n) pass; it knows rotor inertia through model.armature.
        tau = pin.rnea(self._model, self._data, q, v, a)
        self._v[:] = v
        self._add_friction(tau, self._v, self._joints, self._friction.smooth_rad_s)
        return tau


def hold(controller: ComputedTorque, q: Array, v: Array, q_hold: Array) -> Array:
    """Return the torques that hold q_hold (14,) at zero velocity."""
    zero = np.zeros(DOF)
    return controller.torque(q, v, q_hold, zero, zero)
