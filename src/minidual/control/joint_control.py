"""Computed-torque control of all joints (Siciliano et al., Robotics, ch. 8.5.2).

    tau = M(q) [a_ref + 2 zeta wn (v_ref - v) + wn^2 (q_ref - q)] + h(q, v) + d v + c tanh(v / v_s)

Scaling by M gives every joint the same wn, though a shoulder carries over ten times a wrist's inertia. h: Coriolis,
centrifugal and gravity torques.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy import subtract

from minidual.control.kernels import add_friction
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot


@dataclass(frozen=True)
class JointFriction:
    """Friction to cancel: d v + c tanh(v / v_s).

    Dry friction is not cancelled at rest, where a measured velocity's sign is noise.

    Attributes:
        viscous: d, (n,) or scalar [Nm s/rad].
        dry: c, (n,) or scalar [Nm].
        smooth_rad_s: v_s.
    """

    viscous: Array | float
    dry: Array | float = 0.0
    smooth_rad_s: float = 0.02

    @classmethod
    def of(cls, robot: Robot) -> JointFriction:
        """Return the model's friction."""
        return cls(robot.arm.damping, robot.arm.friction)


class ComputedTorque:
    """Tracks joint references.

    Args:
        natural_frequency_rad_s: wn.
        damping_ratio: zeta.
        friction: Default the model's.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        *,
        natural_frequency_rad_s: float = 20.0,
        damping_ratio: float = 1.0,
        friction: JointFriction | None = None,
    ) -> None:
        self._model, self._data = kinematics.model, kinematics.data
        self._gains = np.array([natural_frequency_rad_s**2, 2.0 * damping_ratio * natural_frequency_rad_s, 1.0])
        robot = kinematics.robot
        self._friction = JointFriction.of(robot) if friction is None else friction
        self._joints = np.zeros((3, robot.dof))
        self._joints[0], self._joints[1], self._joints[2] = self._friction.viscous, self._friction.dry, robot.tau_max
        self._v = np.zeros(robot.dof)
        self._errors = np.zeros((3, robot.dof))  # rows: position, velocity, acceleration
        self._e, self._de, self._dde = self._errors

    def torque(self, q: Array, v: Array, q_ref: Array, v_ref: Array, a_ref: Array) -> Array:
        """Return motor torques (n,) [Nm], clipped to the limits."""
        subtract(q_ref, q, self._e)
        subtract(v_ref, v, self._de)
        self._dde[:] = a_ref
        a = self._gains.dot(self._errors)
        # rnea(q, v, a) = M a + h in O(n), with rotor inertia from model.armature.
        tau = pin.rnea(self._model, self._data, q, v, a)
        self._v[:] = v
        add_friction(tau, self._v, self._joints, self._friction.smooth_rad_s)
        return tau
