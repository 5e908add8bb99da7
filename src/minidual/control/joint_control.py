"""Computed-torque control of all 14 joints: gains follow from the inertia seen at each joint.

    tau = M(q) [ a_ref + 2 zeta wn (v_ref - v) + wn^2 (q_ref - q) ] + h(q, v) + d v

Multiplying by the joint-space inertia M gives every joint the same closed-loop natural frequency wn whatever
inertia it carries; a shoulder sees more than ten times the inertia of a wrist, so one number for all would leave
the shoulder slack and the wrist shaking. h holds Coriolis, centrifugal and gravity torques, d the viscous joint
friction. Source: Siciliano et al., Robotics, ch. 8.5.2 (inverse dynamics control).
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from minidual.robot.constants import DOF, JOINT_DAMPING, TAU_MAX, Array
from minidual.robot.kinematics import Kinematics

_DAMPING = np.full(DOF, JOINT_DAMPING)
_TAU_MIN = -TAU_MAX


def within_motors(tau: Array) -> Array:
    """Limit tau (14,) [Nm] to the motors in place and return it; NaN stays NaN.

    Two ufuncs with `out` take a third of the time of `np.clip`, which the 1 kHz step can tell.
    """
    np.minimum(tau, TAU_MAX, tau)
    return np.maximum(tau, _TAU_MIN, tau)


class ComputedTorque:
    """Tracks joint references of both arms.

    Args:
        kinematics: Workspace for the dynamics.
        natural_frequency_rad_s: wn, the same for all joints.
        damping_ratio: zeta.
    """

    def __init__(
        self, kinematics: Kinematics, *, natural_frequency_rad_s: float = 20.0, damping_ratio: float = 1.0
    ) -> None:
        self._model, self._data = kinematics.model, kinematics.data
        self._gains = np.array(
            [natural_frequency_rad_s**2, 2.0 * damping_ratio * natural_frequency_rad_s, 1.0]
        )
        self._errors = np.zeros((3, DOF))  # rows: position, velocity, acceleration
        self._e, self._de, self._dde = self._errors

    def torque(self, q: Array, v: Array, q_ref: Array, v_ref: Array, a_ref: Array) -> Array:
        """Return motor torques (14,) [Nm], clipped to the motors' limits."""
        np.subtract(q_ref, q, self._e)
        np.subtract(v_ref, v, self._de)
        self._dde[:] = a_ref
        a = self._gains.dot(self._errors)
        # rnea(q, v, a) = M a + h in one O(n) pass; it knows rotor inertia through model.armature.
        tau = pin.rnea(self._model, self._data, q, v, a)
        tau += _DAMPING * v
        return within_motors(tau)


def hold(controller: ComputedTorque, q: Array, v: Array, q_hold: Array) -> Array:
    """Return the torques that hold q_hold (14,) at zero velocity."""
    zero = np.zeros(DOF)
    return controller.torque(q, v, q_hold, zero, zero)
