"""Smooth stops with bounded torque rate."""

from collections.abc import Sequence

import numpy as np

from minidual.control.controllers import Controller
from minidual.control.joint_control import ComputedTorque
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot

STOP_SHARE = 0.5
"""Peak deceleration as share of the joints' limits."""
_STOP_FREQUENCY_RAD_S = 8.0  # soft: hands on one object must not fight


class TorqueRate:
    """Limits torque rates from tau (n,) [Nm] on."""

    def __init__(self, tau: Array, dt_s: float, rate_nm_per_s: float) -> None:
        self.tau = tau.copy()
        self._step = rate_nm_per_s * dt_s

    def nearest(self, tau: Array) -> Array:
        """Return the reachable torques (n,) nearest to tau."""
        change = tau - self.tau
        np.minimum(change, self._step, change)
        np.maximum(change, -self._step, change)
        return self.tau + change

    def limit(self, tau: Array) -> Array:
        """Go to the reachable torques (n,) nearest to tau; return them."""
        self.tau = self.nearest(tau)
        return self.tau


class SwitchedOff(TorqueRate):
    """Ramps the torque of some arms to zero, and back if they return, at the drives' rate."""

    def __init__(self, arms: Sequence[int], tau: Array, dt_s: float, robot: Robot) -> None:
        super().__init__(tau, dt_s, robot.arm.tau_rate_max)
        self.arms, self._dof_per_arm = tuple(arms), robot.dof_per_arm

    def nearest(self, tau: Array) -> Array:
        """Return the reachable torques (n,) nearest to tau, or to zero."""
        off = np.repeat([arm in self.arms for arm in (0, 1)], self._dof_per_arm)
        return super().nearest(np.where(off, 0.0, tau))


class SoftStop:
    """Joint reference from (q, v) to rest.

    All joints share v(t) = v_0 (1 - s)^2 (1 + 2 s), s = t/T, so two hands initially move together. Peak deceleration:
    1.5 |v_0| / T.
    """

    def __init__(self, q: Array, v: Array, deceleration: Array, *, least_s: float = 0.1) -> None:
        self._q, self._v = q.copy(), v.copy()
        self.duration_s = max(least_s, float(np.max(1.5 * np.abs(v) / deceleration)))

    def at(self, t_s: float) -> tuple[Array, Array, Array]:
        """Return (q, v, a) at time t; at rest from `duration_s` on."""
        s = min(1.0, max(0.0, t_s / self.duration_s))
        speed = (1.0 - s) ** 2 * (1.0 + 2.0 * s)
        way = s - s**3 + 0.5 * s**4  # the integral of (1 - s)^2 (1 + 2 s) = 1 - 3 s^2 + 2 s^3
        slope = -6.0 * s + 6.0 * s * s
        return (self._q + self.duration_s * way * self._v, speed * self._v, slope / self.duration_s * self._v)


class SoftStopController(Controller):
    """Stops both arms on one profile and holds them softly (see `ControlStack.halt`)."""

    name = "soft_stop"

    def __init__(self, kinematics: Kinematics, dt_s: float) -> None:
        self._servo = ComputedTorque(kinematics, natural_frequency_rad_s=_STOP_FREQUENCY_RAD_S)
        self._dt, self._robot = dt_s, kinematics.robot
        self.activate(self._robot.home, np.zeros(self._robot.dof))

    def activate(self, q: Array, v: Array) -> None:
        """Start stopping from the measurement."""
        self._motion, self._steps = SoftStop(q, v, STOP_SHARE * self._robot.a_max), 0
        self.reference = np.array(q, dtype=float)

    def update(self, q: Array, v: Array) -> Array:
        """See `Controller`."""
        q_ref, v_ref, a_ref = self._motion.at(self._steps * self._dt)
        self._steps += 1
        self.reference = q_ref
        return self._servo.torque(q, v, q_ref, v_ref, a_ref)
