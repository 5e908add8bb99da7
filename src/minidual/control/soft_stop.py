"""Two stops on one braking law: after a halt by a controller, after a reflex by the supervisor."""

from collections.abc import Sequence

import numpy as np

from minidual.config.control import SupervisorConfig
from minidual.control.braking import BrakingLaw, BrakingProfile
from minidual.control.controllers import Controller
from minidual.control.joint_control import ComputedTorque, towards_torque
from minidual.control.measurement import Measurement
from minidual.control.payload import Payload
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import Array, Robot

HALT_SHARE = 0.65
"""Share of the joints' decelerations in a halt: plans come to rest at theirs just before a table or a limit."""
_HALT_FREQUENCY_RAD_S = 8.0  # soft: hands on one object must not fight
_TORQUE_SHARE = 0.9
"""Share of the torque limits that braking may take, gravity included."""
_SLOWER = (1.0, 0.75, 0.5)
"""Shares of the largest deceleration, tried in turn until the torques suffice."""
_RETURNS_RAD_S = 0.3
_LEAD_RAD = 0.1
"""A joint that returns to its reference faster than that, after a push, is led by no more than this."""


def halt_duration_s(robot: Robot, q: Array, v: Array) -> float:
    """Return how long a halt from q, v (n,) takes."""
    law = BrakingLaw(robot, HALT_SHARE)
    return BrakingProfile(law, q, v, law.slopes(q, v), 1e-3).duration_s


class SoftStopController(Controller):
    """Stops both arms and holds them softly (see `ControlStack.halt`); together if both hands are closed."""

    name = "soft_stop"
    compliant = True

    def __init__(self, kinematics: Kinematics, dt_s: float, payload: Payload) -> None:
        self._servo = ComputedTorque(kinematics, natural_frequency_rad_s=_HALT_FREQUENCY_RAD_S)
        self._dt = dt_s
        self._payload = payload
        self._law = BrakingLaw(kinematics.robot, HALT_SHARE)
        home = kinematics.robot.home
        self.activate(home, np.zeros(len(home)))

    def activate(self, q: Array, v: Array) -> None:
        """Start stopping from the measurement."""
        slopes = self._law.slopes(q, v, together=all(self._payload.closed))
        self._profile = BrakingProfile(self._law, q, v, slopes, self._dt)
        self._ticks = 0
        self._load: Array | None = None
        self.reference = np.array(q, dtype=float)

    def update(self, q: Array, v: Array) -> Array:
        """See `Controller`."""
        profile = self._profile
        profile.step()
        if self._ticks % self._payload.every == 0:
            self._load = self._payload.torque(q, profile.q, self.arms, learn=False)
        self._ticks += 1
        self.reference = profile.q
        return self._servo.torque(q, v, profile.q, profile.v, profile.a, self._load)


class SupervisedStop:
    """Torques of the stop after a reflex; `kinematics` must not be the controllers'.

    A blind joint is not servoed: it gets the torque of its estimated motion, so that it coasts, until the brakes hold
    it.
    """

    def __init__(self, kinematics: Kinematics, config: SupervisorConfig, dt_s: float) -> None:
        self._robot = robot = kinematics.robot
        self._servo = ComputedTorque(
            kinematics,
            natural_frequency_rad_s=config.stop_frequency_rad_s,
        )
        self._law = BrakingLaw(robot, config.stop_deceleration_scale)
        self._tau_max = _TORQUE_SHARE * robot.tau_max
        self._tau_step = robot.tau_rate_max * dt_s
        self._dt = dt_s
        self._hands = Hands(kinematics)
        self.weights_n: Sequence[float] = (0.0, 0.0)
        """Weight in each hand."""

    def begin(self, q: Array, v: Array) -> None:
        """Start from finite posture and velocity (n,)."""
        v_0 = np.clip(v, -self._robot.v_max, self._robot.v_max)
        self._profile = BrakingProfile(self._law, q, v_0, self._slopes(q, v_0), self._dt)

    @property
    def reference(self) -> Array:
        """Where the stop has the joints (n,) [rad] now; `begin` comes first."""
        return self._profile.q.copy()

    def rest(self, q: Array, v: Array) -> Array:
        """Return the posture (n,) in which a stop from q, v ends."""
        return self._law.rest(q, v, self._slopes(q, v))

    def _slopes(self, q: Array, v: Array) -> Array:
        """Return the largest slopes (n,) [1/s] that the motors can brake with."""
        largest = self._law.slopes(q, v)
        slopes = largest
        for share in _SLOWER:
            slopes = share * largest
            tau = self._servo.torque(q, v, q, v, -slopes * v)
            if (np.abs(tau) <= self._tau_max).all():
                break
        return slopes

    def torque(self, measurement: Measurement, applied: Array) -> Array:
        """Return this tick's torques (n,) [Nm], within the torque rate of those `applied` last."""
        q = measurement.q
        v = measurement.v
        profile = self._profile
        profile.step()
        lead = profile.q - q
        returns = lead * v > _RETURNS_RAD_S * np.abs(lead)
        led = q + np.clip(lead, -_LEAD_RAD, _LEAD_RAD)
        profile.q = np.where(returns, led, profile.q)
        blind = measurement.blind
        q_ref = np.where(blind, q, profile.q)
        v_ref = np.where(blind, v, profile.v)
        a_ref = np.where(blind, 0.0, profile.a)
        self._hands.update(q)
        load = np.concatenate(
            [weight_n * self._hands.rise(arm) for arm, weight_n in enumerate(self.weights_n)],
        )
        tau = self._servo.torque(q, v, q_ref, v_ref, a_ref, load)
        if not np.isfinite(tau).all():  # a posture far outside the joint limits overflows
            return applied.copy()
        return towards_torque(applied, tau, self._tau_step)
