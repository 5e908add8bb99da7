"""Bring moving arms to rest and hold them there: what follows every reflex of the supervisor.

The reference starts at the measured posture and velocity, brakes each joint with a fixed share of its acceleration
limit, and stays where it comes to rest. The arms follow it by inverse dynamics with soft gains (damped hold):

    tau = M(q) [ a_ref + 2 wn (v_ref - v) + wn^2 (q_ref - q) ] + h(q, v) + d v

The torque starts from what was applied last and changes no faster than the motors' rate limit.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from minidual.config.supervisor import SupervisorConfig
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array


class SupervisedStop:
    """Torques of a controlled stop.

    Args:
        kinematics: Dynamics; a workspace of its own.
        config: Deceleration and stiffness.
        dt_s: Period of the control loop.
    """

    def __init__(self, kinematics: Kinematics, config: SupervisorConfig, dt_s: float) -> None:
        self._model, self._data = kinematics.model, kinematics.data
        self._robot = kinematics.robot
        self._brake = config.stop_deceleration_scale * self._robot.a_max
        self._damping = 2.0 * config.stop_frequency_rad_s
        self._stiffness = config.stop_frequency_rad_s**2
        self._dt = dt_s
        self._tau_step = self._robot.arm.tau_rate_max * dt_s

    def begin(self, q: Array, v: Array, tau: Array) -> None:
        """Start from the last good posture (n,) [rad], velocity [rad/s] and torque applied [Nm]; all finite."""
        self._q, self._v = q.copy(), v.copy()
        self._q_ref, self._v_ref = q.copy(), np.clip(v, -self._robot.v_max, self._robot.v_max)
        self._tau = np.clip(tau, -self._robot.tau_max, self._robot.tau_max)

    def torque(self, q: Array, v: Array) -> Array:
        """Return the torque (n,) [Nm] of this tick.

        A measurement that is not finite is replaced by the last one that was, at rest: gravity is still carried.
        """
        if np.isfinite(q).all() and np.isfinite(v).all():
            self._q, self._v = np.array(q, dtype=float), np.array(v, dtype=float)
        else:
            self._v = np.zeros_like(self._v)
        slower = np.sign(self._v_ref) * np.maximum(0.0, np.abs(self._v_ref) - self._dt * self._brake)
        a_ref = (slower - self._v_ref) / self._dt
        self._v_ref = slower
        self._q_ref = np.clip(self._q_ref + self._dt * slower, self._robot.q_lower, self._robot.q_upper)
        a = a_ref + self._damping * (slower - self._v) + self._stiffness * (self._q_ref - self._q)
        wanted = pin.rnea(self._model, self._data, self._q, self._v, a) + self._robot.arm.damping * self._v
        if np.isfinite(wanted).all():  # a posture far out of this world overflows
            step = np.clip(wanted, -self._robot.tau_max, self._robot.tau_max) - self._tau
            self._tau = self._tau + np.clip(step, -self._tau_step, self._tau_step)
        return self._tau.copy()
