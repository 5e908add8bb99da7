"""External torques by a momentum observer; distance to the reference.

    r <- r + g (M(q) dv/dt + h(q, v) + friction - tau - tau_expected - r)

The observer of p = M v, dp/dt = tau + C^T v - g(q) + tau_ext, stepped over several ticks. Source: Haddadin, De Luca,
Albu-Schaeffer, Robot collisions, IEEE T-RO 33(6), 2017.
"""

import math
from typing import NamedTuple

import numpy as np
from numba.core import types

from minidual.config.control import SupervisorConfig
from minidual.robot.compiled import ROWS, VECTOR, kernel
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array

EVERY = 4
"""Ticks between updates."""
_FILTER_S = 0.012
_LEAST_NM = 3.0
"""Least torque bound: touching fingers turn the weak last joints."""
_WINDOW_MAX = 32
"""Longest step, in ticks; after longer silence it begins anew."""


MODES = {"free motion": (0.15, 20.0, 0.05), "closed hands": (0.5, 60.0, 0.1), "held object": (0.15, 40.0, 0.1)}
"""Allowed torque, relative to the motors' limits, force [N] and deviation [rad] of a mode. Closed hands may squeeze by
position; object impedance tells its load."""


class Expected(NamedTuple):
    """What controllers expect: key of MODES, external torque (n,) [Nm], joints (n,) [rad]; fault of a hand; arms off."""

    mode: str = "free motion"
    torque: Array | None = None
    reference: Array | None = None
    hand_fault: str = ""
    off: tuple[int, ...] = ()


@kernel(types.void(VECTOR, VECTOR, types.float64, ROWS, ROWS))
def halfway(q: Array, v: Array, step_s: float, before: Array, mean: Array) -> None:
    """Fill `mean` (3, n), q, v and dv/dt in mid-step, and `before` (2, n), last q and v."""
    for j in range(len(q)):
        mean[0, j], mean[1, j] = 0.5 * (before[0, j] + q[j]), 0.5 * (before[1, j] + v[j])
        mean[2, j] = (v[j] - before[1, j]) / step_s
        before[0, j], before[1, j] = q[j], v[j]


@kernel(
    types.UniTuple(types.float64, 2)(
        *(VECTOR, ROWS, ROWS, types.int64, types.int64, VECTOR, VECTOR),
        *(VECTOR, types.float64, types.float64, types.float64, types.float64, ROWS),
    )
)
def observe(
    needed: Array,
    mean: Array,
    applied: Array,
    newest: int,
    ticks: int,
    expected: Array,
    reference: Array,
    bounds: Array,
    damping: float,
    dry: float,
    gain: float,
    step_s: float,
    kept: Array,
) -> tuple[float, float]:
    """Update `kept` (3, n): see `ContactSense`; return the largest ratios to bounds of torque and lateness.

    needed: M dv/dt + h (n,). applied: ring of torques (T, n).
    """
    torque, late, n = 0.0, 0.0, len(needed)
    for j in range(n):
        given = 0.0
        for k in range(ticks):
            given += applied[(newest - k) % len(applied), j]
        v = mean[1, j]
        friction = damping * v + (dry * math.tanh(v / 0.02) if dry != 0.0 else 0.0)
        kept[0, j] += gain * (needed[j] + friction - given / ticks - expected[j] - kept[0, j])
        kept[2, j] = mean[0, j] - reference[j]
        kept[1, j] = kept[1, j] + step_s if abs(kept[2, j]) > bounds[n] else 0.0
        ratio = abs(kept[0, j]) / bounds[j]
        torque = torque if ratio <= torque else ratio  # keeps NaN
        late = max(late, kept[1, j] / bounds[n + 1])
    return torque, late


class ContactSense:
    """Observes external torques.

    Attributes:
        torque: (n,) [Nm], unexplained.
        late_s: (n,), time too far from the reference.
        away: (n,) [rad] from it.
        limits: (n + 3,), the bounds in force.
    """

    def __init__(self, kinematics: Kinematics, config: SupervisorConfig, dt_s: float) -> None:
        self._kinematics, robot, self._dt = kinematics, kinematics.robot, dt_s
        self._friction = robot.arm.damping, robot.arm.friction
        self.bounds: dict[str, Array] = {}
        """(n + 3,) of each mode: torques [Nm], distance [rad], patience [s], force [N]."""
        for name, (share, force_n, deviation_rad) in MODES.items():
            torques = config.contact_scale * np.maximum(share * robot.tau_max, _LEAST_NM)
            late = config.deviation_scale * deviation_rad, config.deviation_s
            self.bounds[name] = np.r_[torques, late, config.contact_scale * force_n]
        self._before, self._mean = np.zeros((2, robot.dof)), np.zeros((3, robot.dof))
        self._nothing, self.limits = np.zeros(robot.dof), self.bounds["free motion"]
        self.reset()

    def reset(self) -> None:
        """Start at the next measurement."""
        self.torque, self.late_s, self.away = self._kept = np.zeros((3, len(self._nothing)))
        self._stamp_s = math.nan

    def update(
        self, stamp_s: float, q: Array, v: Array, applied: Array, newest: int, expected: Expected
    ) -> tuple[float, float]:
        """Take q, v (n,) measured at `stamp_s`; return as `observe`.

        applied: ring of torques (T, n), `newest` the last row before that time.
        """
        step_s, self._stamp_s = stamp_s - self._stamp_s, stamp_s
        if not 0.5 * self._dt < step_s < _WINDOW_MAX * self._dt:  # the first, or after a silence
            self._before[:] = q, v
            return 0.0, 0.0
        halfway(q, v, step_s, self._before, self._mean)
        torque, reference = expected.torque, expected.reference
        self.limits = self.bounds[expected.mode]
        if expected.off:  # their motors do not give what is applied
            self.limits, reference = self.limits.copy(), self._mean[0] if reference is None else reference.copy()
            for arm in expected.off:
                joints = self._kinematics.robot.joints_of(arm)
                self.limits[joints], reference[joints] = math.inf, self._mean[0, joints]
        return observe(
            self._kinematics.rnea(*self._mean),
            *(self._mean, applied, newest, round(step_s / self._dt)),
            self._nothing if torque is None else torque,
            self._mean[0] if reference is None else reference,
            *(self.limits, *self._friction, -math.expm1(-step_s / _FILTER_S), step_s, self._kept),
        )
