"""Computed-torque control of all joints (Siciliano et al., Robotics, ch. 8.5.2).

    tau = M(q) [a_ref + 2 wn (v_ref - v) + wn^2 (q_ref - q)] + h(q, v) + d v + c tanh(v / v_s)

h: Coriolis, centrifugal and gravity torques.
"""

import numpy as np
import pinocchio as pin

from minidual.control.kernels import add_friction, servo
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array


class Motors:
    """Turns accelerations and loads into motor torques."""

    def __init__(self, kinematics: Kinematics) -> None:
        self._kinematics, arm = kinematics, kinematics.robot.arm
        self._limits = arm.damping, arm.friction, np.array(kinematics.robot.tau_max)

    def torque(self, q: Array, v: Array, a: Array, load: Array | None = None) -> Array:
        """Return torques (n,) [Nm] for accelerations a (n,) and load (n,), clipped to the limits; NaN stays NaN."""
        # rnea(q, v, a) = M a + h in O(n), with rotor inertia from model.armature.
        tau = pin.rnea(self._kinematics.model, self._kinematics.data, q, v, a)
        if load is not None:
            tau += load
        add_friction(tau, v, *self._limits)
        return tau


class ComputedTorque:
    """Tracks joint references with natural frequency wn, critically damped."""

    def __init__(self, kinematics: Kinematics, *, natural_frequency_rad_s: float = 20.0) -> None:
        self._motors, self._w = Motors(kinematics), natural_frequency_rad_s
        self._a = np.zeros(kinematics.robot.dof)

    def torque(self, q: Array, v: Array, q_ref: Array, v_ref: Array, a_ref: Array, load: Array | None = None) -> Array:
        """Return motor torques (n,) [Nm], clipped to the limits; load (n,) as in `Motors`."""
        servo(q, v, q_ref, v_ref, a_ref, self._w, self._a)
        return self._motors.torque(q, v, self._a, load)
