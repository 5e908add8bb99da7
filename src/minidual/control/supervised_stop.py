"""Controlled stop after a reflex: brake all joints on one profile, then hold, within the torque rate.

v_ref = r v_0 with one r for both arms, so hands that hold one object keep together. A joint that would reach its
position limit on the way brakes on its own.
"""

import math

import numpy as np
from numba.core import types

from minidual.config.supervisor import SupervisorConfig
from minidual.control.joint_control import ComputedTorque
from minidual.control.soft_stop import TorqueRate
from minidual.robot.compiled import VECTOR, floats, kernel
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array

_RAMP_S = 0.06
"""Rise and fall time of the deceleration."""
_LEAST_S = 0.05
_TORQUE_SHARE = 0.9
"""Share of the torque limits that braking may take, gravity included."""
_SLOWER = (1.0, 0.75, 0.5)
"""Shares of the largest deceleration, tried in turn until the torques suffice."""


@kernel(types.void(*[VECTOR] * 6))
def slopes(q: Array, v: Array, brake: Array, q_lower: Array, q_upper: Array, slope: Array) -> None:
    """Fill the decrease of r (n,) [1/s] at full braking, common but near position limits."""
    common = math.inf
    for j in range(len(q)):
        slope[j] = brake[j] / max(abs(v[j]), brake[j] * _LEAST_S)
        common = min(common, slope[j])
    for j in range(len(q)):
        room = q_upper[j] - q[j] if v[j] > 0.0 else q[j] - q_lower[j]
        if abs(v[j]) * (0.5 / common + _RAMP_S) <= room:
            slope[j] = common


class SupervisedStop:
    """Torques of the stop; `kinematics` must not be the controllers'."""

    def __init__(self, kinematics: Kinematics, config: SupervisorConfig, dt_s: float) -> None:
        self._robot = kinematics.robot
        self._servo = ComputedTorque(kinematics, natural_frequency_rad_s=config.stop_frequency_rad_s)
        robot = self._robot
        self._brake = config.stop_deceleration_scale * robot.a_max
        self._v_max, self._tau_max = robot.v_max, _TORQUE_SHARE * robot.tau_max
        self._range = floats(robot.q_lower), floats(robot.q_upper)
        self._dt = dt_s

    def begin(self, q: Array, v: Array, tau: Array) -> None:
        """Start from finite posture, velocity and applied torque (n,)."""
        robot = self._robot
        self._q_ref, self._v_0 = q.copy(), np.clip(v, -robot.v_max, robot.v_max)
        self._r, self._slope = np.ones(robot.dof), np.zeros(robot.dof)
        self._slope_max = self._largest_slope(self._q_ref, self._v_0)
        self._rate = TorqueRate(np.clip(tau, -robot.tau_max, robot.tau_max), self._dt, robot.arm.tau_rate_max)

    def rest(self, q: Array, v: Array) -> Array:
        """Return the posture (n,) in which a stop from q, v ends."""
        v_0 = np.minimum(np.maximum(v, -self._v_max), self._v_max)
        way = v_0 * (0.5 / self._largest_slope(q, v_0) + 0.5 * _RAMP_S)  # r falls symmetrically
        return np.minimum(np.maximum(q + way, self._range[0]), self._range[1])

    def _largest_slope(self, q: Array, v: Array) -> Array:
        slope = np.empty_like(q)
        slopes(q, v, self._brake, *self._range, slope)
        for share in _SLOWER:
            shared = share * slope
            if (np.abs(self._servo.torque(q, v, q, v, -shared * v)) <= self._tau_max).all():
                break
        return shared

    @property
    def tau(self) -> Array:
        """Last torque (n,) [Nm]."""
        return self._rate.tau

    def torque(self, q: Array, v: Array) -> Array:
        """Return this tick's torque (n,) [Nm] at usable q, v (see `JointSense`)."""
        # Slope and r reach zero together, within the ramp time.
        rise = self._slope + self._slope_max * self._dt / _RAMP_S
        fall = np.sqrt(2.0 * self._r * self._slope_max / _RAMP_S)
        self._slope = np.minimum(np.minimum(rise, fall), self._slope_max)
        self._r = np.maximum(0.0, self._r - self._slope * self._dt)
        v_ref, a_ref = self._r * self._v_0, -self._slope * self._v_0
        self._q_ref = np.clip(self._q_ref + self._dt * v_ref, self._robot.q_lower, self._robot.q_upper)
        wanted = self._servo.torque(q, v, self._q_ref, v_ref, a_ref)
        if np.isfinite(wanted).all():  # a posture far outside the joint limits overflows
            self._rate.limit(wanted)
        return self._rate.tau.copy()
