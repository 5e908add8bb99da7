"""Estimate: external torques of the arms, by a momentum observer.

    r <- r + g (M(q) dv/dt + h(q, v) + friction - tau - tau_expected - r)

Source: Haddadin, De Luca, Albu-Schaeffer, Robot collisions, IEEE T-RO 33(6), 2017.
"""

import math
from typing import NamedTuple

import numpy as np
from numba.core import types

from minidual.config.control import SupervisorConfig
from minidual.control.measurement import Measurement
from minidual.robot.compiled import ROWS, VECTOR, kernel
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array

EVERY_S = 0.004
"""Period of the observer."""
STILL_RAD_S = 0.001
_MOVED_RAD_S = 0.05
"""A slower joint is still; one that was faster a moment before has been stopped."""
FILTER_S = 0.012
_STEADY_S = 0.1
PLANT_DEVIATION_RAD = 0.15
PLANT_DEVIATION_S = 0.1
"""Distance from the reference, and for how long, of a plant that interpolates joint targets itself."""
LEAST_NM = 3.0
"""Least torque bound: touching fingers turn the weak last joints."""
_WINDOW_MAX = 32
"""Longest step between two updates, in ticks; after longer silence the observer begins anew."""
_APPLIED_N = 64
"""Applied torques kept, in ticks."""


class ContactMode(NamedTuple):
    """What the arms may feel in a way of working.

    Attributes:
        torque_share: Unexplained torque, relative to the motors' limits.
        force_n: Force of a hand on its surroundings.
        deviation_rad: Distance of a joint from its reference.
    """

    torque_share: float
    force_n: float
    deviation_rad: float


CONTACT_MODES = {
    "free motion": ContactMode(0.15, 20.0, 0.05),
    "closed hands": ContactMode(0.5, 60.0, 0.1),  # they may squeeze by position
    "held object": ContactMode(0.15, 40.0, 0.1),  # the object impedance says what it presses
}


class Expected(NamedTuple):
    """What the controllers expect the observer to find.

    Attributes:
        mode: Key of CONTACT_MODES.
        torque: External torque (n,) [Nm], or None for none.
        reference: Joint reference (n,) [rad], or None for no comparison.
        hand_fault: Which hand has lost its grip, or empty.
    """

    mode: str = "free motion"
    torque: Array | None = None
    reference: Array | None = None
    hand_fault: str = ""


class ContactBounds(NamedTuple):
    """Bounds of one mode: torques (n,) [Nm], distance from the reference [rad] and for how long [s], force [N]."""

    torques: Array
    deviation_rad: float
    deviation_s: float
    force_n: float


@kernel(types.void(VECTOR, VECTOR, types.float64, ROWS, ROWS))
def halfway(q: Array, v: Array, step_s: float, last: Array, mean: Array) -> None:
    """Fill `mean` (3, n) with q, v and dv/dt in the middle of a step, and `last` (2, n) with q, v (n,)."""
    for j in range(len(q)):
        mean[0, j] = 0.5 * (last[0, j] + q[j])
        mean[1, j] = 0.5 * (last[1, j] + v[j])
        mean[2, j] = (v[j] - last[1, j]) / step_s
        last[0, j] = q[j]
        last[1, j] = v[j]


_EXTERNAL, _STEADY, _AWAY, _LATE_S = range(4)


# One array an argument: see `bounds.excess`.
@kernel(
    types.intp(VECTOR, ROWS, ROWS, types.intp, types.intp, VECTOR, VECTOR, VECTOR, VECTOR, ROWS)
)
def observe(
    needed: Array,
    mean: Array,
    applied: Array,
    newest: int,
    ticks: int,
    expected: Array,
    reference: Array,
    constants: Array,
    torque_max: Array,
    state: Array,
) -> int:
    """Update the observer; return the number of joints beyond a bound.

    Args:
        needed: M dv/dt + h (n,) [Nm].
        mean: (3, n), see `halfway`.
        applied: Ring of applied torques (rows, n) [Nm].
        newest, ticks: Row of the step's last torque, and the number of its torques.
        expected: External torque (n,) [Nm].
        reference: (n,) [rad].
        constants: Damping [Nm s/rad], dry friction [Nm], gain, step [s], allowed deviation [rad] and for how
            long [s].
        torque_max: Bounds of the unexplained torque (n,) [Nm].
        state: (4, n), updated: unexplained torque, its mean of 0.1 s, distance from the reference [rad], and
            the time for which that is too far [s].
    """
    damping = constants[0]
    dry = constants[1]
    gain = constants[2]
    step_s = constants[3]
    slowly = min(1.0, step_s / _STEADY_S)
    beyond_n = 0
    for j in range(len(needed)):
        total = applied[newest, j]
        for k in range(1, ticks):
            total += applied[(newest - k) % len(applied), j]
        v = mean[1, j]
        friction = damping * v + (dry * math.tanh(v / 0.02) if dry != 0.0 else 0.0)
        change = 0.5 * step_s * mean[2, j]
        stopped = abs(v + change) < STILL_RAD_S and abs(v - change) > _MOVED_RAD_S
        follow = 1.0 if stopped else gain  # at once: the torque that stopped it is soon over
        unexplained = needed[j] + friction - total / ticks - expected[j]
        state[_EXTERNAL, j] += follow * (unexplained - state[_EXTERNAL, j])
        state[_STEADY, j] += slowly * (state[_EXTERNAL, j] - state[_STEADY, j])
        state[_AWAY, j] = mean[0, j] - reference[j]
        late = abs(state[_AWAY, j]) > constants[4]
        state[_LATE_S, j] = state[_LATE_S, j] + step_s if late else 0.0
        within = abs(state[_EXTERNAL, j]) <= torque_max[j]  # false for NaN
        if not within or state[_LATE_S, j] > constants[5]:
            beyond_n += 1
    return beyond_n


class ContactObserver:
    """Observes external torques.

    Attributes:
        external: Unexplained torque (n,) [Nm].
        steady: Its mean (n,) of the last 0.1 s.
        away: Distance from the reference (n,) [rad].
        late_s: For how long that is too far (n,) [s].
        needed: Torque (n,) [Nm] that posture and motion take, contacts included; NaN before the first update.
        bounds: In force.
    """

    def __init__(self, kinematics: Kinematics, config: SupervisorConfig, dt_s: float) -> None:
        self._kinematics = kinematics
        robot = kinematics.robot
        self._dt = dt_s
        self._delay_s = config.torque_delay_s
        self.modes: dict[str, ContactBounds] = {}
        for name, mode in CONTACT_MODES.items():
            torques = np.maximum(mode.torque_share * robot.tau_max, LEAST_NM)
            self.modes[name] = ContactBounds(
                config.contact_scale * torques,
                config.deviation_scale * mode.deviation_rad,
                config.deviation_s,
                config.contact_scale * mode.force_n,
            )
        self._every = max(1, round(EVERY_S / dt_s))
        self._last = np.zeros((2, robot.dof))
        self._mean = np.zeros((3, robot.dof))
        self._nothing = np.zeros(robot.dof)
        self._constants = np.zeros(6)
        self._constants[:2] = robot.arm.damping, robot.arm.friction
        self._state = np.zeros((4, robot.dof))
        self.external, self.steady, self.away, self.late_s = self._state
        self._applied = np.zeros((_APPLIED_N, robot.dof))
        self.reset()

    def reset(self) -> None:
        """Start at the next measurement."""
        self._state[:] = 0.0
        self.needed = np.full(len(self._nothing), math.nan)
        self.bounds = self.modes["free motion"]
        self._stamp_s = math.nan
        self._ticks = 0
        self._due_tick = self._every

    def leave_contacts_to_plant(self) -> None:
        """Compare postures only: a plant with drives of its own feels contacts, and follows targets later."""
        for name, bounds in self.modes.items():
            self.modes[name] = ContactBounds(
                np.full_like(bounds.torques, math.inf),
                PLANT_DEVIATION_RAD,
                PLANT_DEVIATION_S,
                math.inf,
            )
        self.bounds = self.modes["free motion"]

    def forget_needed(self) -> None:
        """Say that the needed torque is unknown: in a stop a joint at rest may stand under any torque."""
        self.needed = np.full(len(self._nothing), math.nan)

    def note(self, applied: Array) -> None:
        """Keep the torque (n,) [Nm] applied since the last tick; call in each."""
        self._applied[self._ticks % _APPLIED_N] = applied
        self._ticks += 1

    @property
    def due(self) -> bool:
        """Whether the next new measurement is for an update; measurements may come in any phase."""
        return self._ticks >= self._due_tick

    def update(self, measurement: Measurement, expected: Expected) -> int:
        """Update all attributes; return the number of joints beyond a bound."""
        self._due_tick = (self._ticks // self._every + 1) * self._every
        lag = max(0, round((measurement.age_s + self._delay_s) / self._dt))
        if self._ticks <= lag + self._every or lag + _WINDOW_MAX >= _APPLIED_N:
            return 0  # torques before the start are not known
        step_s = measurement.stamp_s - self._stamp_s
        self._stamp_s = measurement.stamp_s
        if not 0.5 * self._dt < step_s < _WINDOW_MAX * self._dt:  # the first, or after a silence
            self._last[:] = measurement.q, measurement.v
            return 0
        halfway(measurement.q, measurement.v, step_s, self._last, self._mean)
        self.bounds = self.modes[expected.mode]
        self._constants[2] = -math.expm1(-step_s / FILTER_S)
        self._constants[3] = step_s
        self._constants[4] = self.bounds.deviation_rad
        self._constants[5] = self.bounds.deviation_s
        needed = self._kinematics.rnea(*self._mean)
        torque = self._nothing if expected.torque is None else expected.torque
        beyond_n = observe(
            needed,
            self._mean,
            self._applied,
            (self._ticks - 1 - lag) % _APPLIED_N,
            round(step_s / self._dt),
            torque,
            self._mean[0] if expected.reference is None else expected.reference,
            self._constants,
            self.bounds.torques,
            self._state,
        )
        self.needed = needed - torque
        return beyond_n
