"""Stops with bounded torque rate.

After a halt, `SoftStopController` brings the joints of an arm to rest on one profile, of both arms if both hands are
closed. After a reflex, `SupervisedStop` brakes on v_ref = r v_0 and holds, with one r for both arms, so hands that hold
one object keep together. A joint that would reach its position limit on the way brakes on its own.
"""

import math
from collections.abc import Sequence

import numpy as np
from numba.core import types

from minidual.config.control import SupervisorConfig
from minidual.control.controllers import Controller, Payload
from minidual.control.joint_control import ComputedTorque
from minidual.robot.compiled import ROWS, VECTOR, VIEW, kernel
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import SIDES, Array, Robot

STOP_SHARE = 0.65
"""Peak deceleration as share of the joints' limits: plans come to rest at theirs just before a table or a limit."""
_STOP_LEAST_S = 0.1
_STOP_FREQUENCY_RAD_S = 8.0  # soft: hands on one object must not fight


class TorqueRate:
    """Limits torque rates from tau (n,) [Nm] on."""

    def __init__(self, tau: Array, dt_s: float, rate_nm_per_s: float) -> None:
        self.tau = tau.copy()
        self._step = rate_nm_per_s * dt_s

    def nearest(self, tau: Array) -> Array:
        """Return the reachable torques (n,) nearest to tau."""
        return self.tau + np.clip(tau - self.tau, -self._step, self._step)

    def limit(self, tau: Array) -> Array:
        """Go to the reachable torques (n,) nearest to tau; return them."""
        self.tau = self.nearest(tau)
        return self.tau


class SwitchedOff(TorqueRate):
    """Ramps the torque of some arms to zero, and back if they return, at the drives' rate."""

    def __init__(self, arms: Sequence[int], tau: Array, dt_s: float, robot: Robot) -> None:
        super().__init__(tau, dt_s, robot.arm.tau_rate_max)
        self.arms = tuple(arms)
        self._dof_per_arm = robot.dof_per_arm

    def nearest(self, tau: Array) -> Array:
        """Return the reachable torques (n,) nearest to tau, or to zero."""
        off = np.repeat([arm in self.arms for arm in (0, 1)], self._dof_per_arm)
        return super().nearest(np.where(off, 0.0, tau))


class SoftStop:
    """Joint reference from (q, v) to rest.

    Joints follow v(t) = v_0 (1 - s)^2 (1 + 2 s), s = t/T, with one T for each arm, or for both where they move
    `together`; a joint that would pass its `limits` (2, n) has its own. Peak deceleration 1.5 |v_0| / T: `most` (n,),
    and 1.54 times that before a limit.
    """

    def __init__(
        self,
        q: Array,
        v: Array,
        most: Array,
        limits: Array | None = None,
        *,
        together: bool = True,
    ) -> None:
        self._q = q.copy()
        self._v = v.copy()
        times_s = (1.5 * np.abs(v) / most).reshape(len(SIDES), -1)
        self.duration_s = max(_STOP_LEAST_S, float(times_s.max()))
        self._from_s = np.zeros_like(v)
        arms_s = np.maximum(_STOP_LEAST_S, times_s.max(axis=1))
        self._times_s = (
            np.full(len(v), self.duration_s) if together else np.repeat(arms_s, times_s.shape[1])
        )
        if limits is not None:  # it goes on by v_0 T / 2
            least_s = (
                2.0 * np.where(v > 0.0, limits[1] - q, q - limits[0]) / np.maximum(np.abs(v), 1e-9)
            )
            own_s = np.maximum(np.maximum(STOP_SHARE * times_s.ravel(), least_s), 0.01)
            self._times_s = np.where(
                self._times_s > least_s,
                np.minimum(own_s, self._times_s),
                self._times_s,
            )

    def renew(self, joints: slice, t_s: float, anew: "SoftStop") -> None:
        """Move these joints as another stop does that begins at time t."""
        for name in ("_q", "_v", "_times_s"):
            getattr(self, name)[joints] = getattr(anew, name)[joints]
        self._from_s[joints] = t_s

    def at(self, t_s: float) -> tuple[Array, Array, Array]:
        """Return (q, v, a) at time t; at rest from `duration_s` on, if not renewed."""
        s = np.clip((t_s - self._from_s) / self._times_s, 0.0, 1.0)
        speed = (1.0 - s) ** 2 * (1.0 + 2.0 * s)
        way = s - s**3 + 0.5 * s**4  # the integral of (1 - s)^2 (1 + 2 s) = 1 - 3 s^2 + 2 s^3
        slope = -6.0 * s + 6.0 * s * s
        return (
            self._q + self._times_s * way * self._v,
            speed * self._v,
            slope / self._times_s * self._v,
        )


class SoftStopController(Controller):
    """Stops both arms and holds them softly (see `ControlStack.halt`)."""

    name = "soft_stop"

    def __init__(self, kinematics: Kinematics, dt_s: float, payload: Payload) -> None:
        self._servo = ComputedTorque(kinematics, natural_frequency_rad_s=_STOP_FREQUENCY_RAD_S)
        self._dt = dt_s
        self._robot = kinematics.robot
        self._payload = payload
        self.activate(self._robot.home, np.zeros(self._robot.dof))

    def activate(self, q: Array, v: Array) -> None:
        """Start stopping from the measurement."""
        self._motion = self._stop(q, v)
        self._steps = 0
        self.reference = np.array(q, dtype=float)

    def regain(self, arms: Sequence[int], q: Array, v: Array) -> None:
        """See `Controller`; the other arm goes on braking."""
        for arm in arms:
            self._motion.renew(self._robot.joints_of(arm), self._steps * self._dt, self._stop(q, v))

    def _stop(self, q: Array, v: Array) -> SoftStop:
        limits = np.array([self._robot.q_lower, self._robot.q_upper])
        both = all(self._payload.closed)
        return SoftStop(q, v, STOP_SHARE * self._robot.a_max, limits, together=both)

    def update(self, q: Array, v: Array) -> Array:
        """See `Controller`."""
        q_ref, v_ref, a_ref = self._motion.at(self._steps * self._dt)
        if self._steps % self._payload.every == 0:
            self._load = self._payload.torque(q, q_ref, self.arms, learn=False)
        self._steps += 1
        self.reference = q_ref
        return self._servo.torque(q, v, q_ref, v_ref, a_ref, self._load)


_RAMP_S = 0.06
"""Rise and fall time of the deceleration."""
_LEAST_S = 0.05
_LEAST_R = 1e-3
_BACK_RAD_S = 0.3
_AHEAD_RAD = 0.1
"""A joint that goes back faster than this, after a push or without power, is held this far ahead of where it is."""
_TORQUE_SHARE = 0.9
"""Share of the torque limits that braking may take, gravity included."""
_SLOWER = (1.0, 0.75, 0.5)
"""Shares of the largest deceleration, tried in turn until the torques suffice."""


@kernel(types.void(VIEW, VECTOR, VECTOR, ROWS, VECTOR))
def braking(q: Array, v: Array, most: Array, limits: Array, slope: Array) -> None:
    """Fill `slope` (n,) [1/s] of r: the least of all at decelerations `most` (n,), but near `limits` (2, n) a joint's own."""
    common = math.inf
    for j in range(len(v)):
        slope[j] = most[j] / max(abs(v[j]), most[j] * _LEAST_S)
        common = min(common, slope[j])
    for j in range(len(v)):
        room = limits[1, j] - q[j] if v[j] > 0.0 else q[j] - limits[0, j]
        if abs(v[j]) * (0.5 / common + _RAMP_S) <= room:
            slope[j] = common


@kernel(types.void(VIEW, VECTOR, VECTOR, ROWS, VECTOR))
def come_to_rest(q: Array, v: Array, slope: Array, limits: Array, where: Array) -> None:
    """Fill `where` (n,), from q, v at this slope of r, which falls symmetrically; NaN stays."""
    for j in range(len(v)):
        x = q[j] + v[j] * (0.5 / slope[j] + 0.5 * _RAMP_S)
        low = limits[0, j]
        high = limits[1, j]
        where[j] = low if x < low else high if x > high else x


class SupervisedStop:
    """Torques of the stop; `kinematics` must not be the controllers'."""

    def __init__(self, kinematics: Kinematics, config: SupervisorConfig, dt_s: float) -> None:
        self._robot = robot = kinematics.robot
        self._servo = ComputedTorque(
            kinematics,
            natural_frequency_rad_s=config.stop_frequency_rad_s,
        )
        self._brake = config.stop_deceleration_scale * robot.a_max
        self._v_max = robot.v_max
        self._tau_max = _TORQUE_SHARE * robot.tau_max
        self._limits = np.array([robot.q_lower, robot.q_upper])
        self._dt = dt_s
        self._hands = Hands(kinematics)
        self.bears_n: Sequence[float] = (0.0, 0.0)
        """Weight in each hand."""
        self.v = np.zeros(robot.dof)
        """Reference (n,) [rad/s]."""

    def begin(self, q: Array, v: Array, tau: Array, anew: Array | bool | None = None) -> None:
        """Start from finite posture, velocity and applied torque (n,).

        With `anew` a stop under way goes on: at its deceleration, and from its own reference for the joints not `anew`.
        """
        robot = self._robot
        under_way = 0.0 if anew is None else self._slope / np.maximum(self._r, _LEAST_R)
        self._q_ref = q.copy() if anew is None else np.where(anew, q, self._q_ref)
        self._v_0 = self.v = np.clip(v, -robot.v_max, robot.v_max)
        self._r, self._slope_max = np.ones(robot.dof), self._largest_slope(self._q_ref, self._v_0)
        # Where the ramp would end beyond a position limit, the deceleration begins in full.
        room = np.where(self.v > 0.0, self._limits[1] - q, q - self._limits[0])
        close = np.abs(self.v) * (0.5 / self._slope_max + 0.5 * _RAMP_S) > room
        self._slope = np.where(close, self._slope_max, np.minimum(under_way, self._slope_max))
        self._rate = TorqueRate(
            np.clip(tau, -robot.tau_max, robot.tau_max),
            self._dt,
            robot.arm.tau_rate_max,
        )

    def resume(self, tau: Array) -> None:
        """Go on from torques tau (n,) [Nm]: the last ones did not reach the motors."""
        self.tau = self._rate.tau = tau.copy()

    def rest(self, q: Array, v: Array) -> Array:
        """Return the posture (n,) in which a stop from q, v ends."""
        v_0 = np.minimum(np.maximum(v, -self._v_max), self._v_max)
        come_to_rest(q, v_0, self._largest_slope(q, v_0), self._limits, where := np.empty_like(q))
        return where

    def _largest_slope(self, q: Array, v: Array) -> Array:
        """Return the decrease of r (n,) [1/s] at the largest feasible braking, common but near position limits."""
        braking(q, v, self._brake, self._limits, slope := np.empty_like(q))
        for share in _SLOWER:
            shared = share * slope
            if (np.abs(self._servo.torque(q, v, q, v, -shared * v)) <= self._tau_max).all():
                break
        return shared

    def torque(self, q: Array, v: Array) -> Array:
        """Return this tick's torque (n,) [Nm] at usable q, v (see `JointSense`)."""
        # Slope and r reach zero together, within the ramp time.
        rise = self._slope + self._slope_max * self._dt / _RAMP_S
        fall = np.sqrt(2.0 * self._r * self._slope_max / _RAMP_S)
        self._slope = np.minimum(np.minimum(rise, fall), self._slope_max)
        self._r = np.maximum(0.0, self._r - self._slope * self._dt)
        self.v = self._r * self._v_0
        a_ref = -self._slope * self._v_0
        self._q_ref = np.clip(
            self._q_ref + self._dt * self.v,
            self._robot.q_lower,
            self._robot.q_upper,
        )
        way = self._q_ref - q
        back = way * v > _BACK_RAD_S * np.abs(way)
        self._q_ref[back] = (q + np.clip(way, -_AHEAD_RAD, _AHEAD_RAD))[back]
        self._hands.update(q)
        load = np.concatenate(
            [force_n * self._hands.rise(arm) for arm, force_n in enumerate(self.bears_n)],
        )
        wanted = self._servo.torque(q, v, self._q_ref, self.v, a_ref, load)
        if np.isfinite(wanted).all():  # a posture far outside the joint limits overflows
            self._rate.limit(wanted)
        self.tau = self._rate.tau.copy()
        return self.tau
