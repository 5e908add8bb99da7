"""Controlled stop after a reflex: brake each joint at a share of its limit, then hold, within the torque rate."""

from __future__ import annotations

import numpy as np

from minidual.config.supervisor import SupervisorConfig
from minidual.control.joint_control import ComputedTorque
from minidual.control.soft_stop import TorqueRate
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array


class SupervisedStop:
    """Torques of the stop; `kinematics` must not be the controllers'."""

    def __init__(self, kinematics: Kinematics, config: SupervisorConfig, dt_s: float) -> None:
        self._robot = kinematics.robot
        self._servo = ComputedTorque(kinematics, natural_frequency_rad_s=config.stop_frequency_rad_s)
        self._brake = config.stop_deceleration_scale * self._robot.a_max
        self._dt = dt_s

    def begin(self, q: Array, v: Array, tau: Array) -> None:
        """Start from finite posture, velocity and applied torque (n,)."""
        robot = self._robot
        self._q, self._v = q.copy(), v.copy()
        self._q_ref, self._v_ref = q.copy(), np.clip(v, -robot.v_max, robot.v_max)
        self._rate = TorqueRate(np.clip(tau, -robot.tau_max, robot.tau_max), self._dt, robot.arm.tau_rate_max)

    def torque(self, q: Array, v: Array) -> Array:
        """Return this tick's torque (n,) [Nm].

        The last finite posture, at rest, replaces non-finite measurements, so gravity stays compensated.
        """
        if np.isfinite(q).all() and np.isfinite(v).all():
            self._q, self._v = np.array(q, dtype=float), np.array(v, dtype=float)
        else:
            self._v = np.zeros_like(self._v)
        slower = np.sign(self._v_ref) * np.maximum(0.0, np.abs(self._v_ref) - self._dt * self._brake)
        a_ref = (slower - self._v_ref) / self._dt
        self._v_ref = slower
        self._q_ref = np.clip(self._q_ref + self._dt * slower, self._robot.q_lower, self._robot.q_upper)
        wanted = self._servo.torque(self._q, self._v, self._q_ref, slower, a_ref)
        if np.isfinite(wanted).all():  # a posture far outside the joint limits overflows
            self._rate.limit(wanted)
        return self._rate.tau.copy()
