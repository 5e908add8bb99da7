"""The braking law: where and how joints come to rest.

All joints of a group follow v(t) = r(t) v_0 with one r, so hands that hold one object keep together. r falls from 1 to
0: its slope rises to its largest value within `RAMP_S` and falls back within the same time. A joint that would pass its
position limit on the way brakes on its own.
"""

import math

import numpy as np
from numba.core import types

from minidual.robot.compiled import ROWS, VECTOR, VIEW, kernel
from minidual.robot.pair import Array, Robot

RAMP_S = 0.06
"""Rise and fall time of the deceleration."""
_LEAST_S = 0.05
"""Shortest time in which a slow joint comes to rest."""


def rest_posture(q: Array, v: Array, deceleration: Array) -> Array:
    """Return where joints (n,) stop if each brakes at a constant `deceleration` (n,) [rad/s^2]."""
    return q + v * np.abs(v) / (2.0 * deceleration)


@kernel(types.void(VIEW, VECTOR, VECTOR, ROWS, types.intp, VECTOR))
def fill_slopes(
    q: Array,
    v: Array,
    deceleration: Array,
    limits: Array,
    first_n: int,
    slopes: Array,
) -> None:
    """Fill `slopes` (n,) [1/s] of r: one for the first `first_n` joints and one for the others, but near limits (2, n) a joint's own."""
    for first, end in ((0, first_n), (first_n, len(v))):
        common = math.inf
        for j in range(first, end):
            slopes[j] = deceleration[j] / max(abs(v[j]), deceleration[j] * _LEAST_S)
            common = min(common, slopes[j])
        for j in range(first, end):
            room = limits[1, j] - q[j] if v[j] > 0.0 else q[j] - limits[0, j]
            if abs(v[j]) * (0.5 / common + RAMP_S) <= room:
                slopes[j] = common


@kernel(types.void(VIEW, VECTOR, VECTOR, ROWS, VECTOR))
def fill_rest(q: Array, v: Array, slopes: Array, limits: Array, rest: Array) -> None:
    """Fill `rest` (n,), where r comes to 0 at these slopes; NaN stays."""
    for j in range(len(v)):
        x = q[j] + v[j] * (0.5 / slopes[j] + 0.5 * RAMP_S)
        low = limits[0, j]
        high = limits[1, j]
        if x < low:
            x = low
        elif x > high:
            x = high
        rest[j] = x


class BrakingLaw:
    """Slopes of r and rest postures at a share of the joints' largest decelerations."""

    def __init__(self, robot: Robot, share: float) -> None:
        self.limits = np.array([robot.q_lower, robot.q_upper])
        self._deceleration = share * robot.a_max
        self._v_max = robot.v_max
        self._dof = robot.dof
        self._left_n = robot.dofs[0]

    def slopes(self, q: Array, v: Array, *, together: bool = True) -> Array:
        """Return the slopes of r (n,) [1/s]; `together`: one for both arms."""
        slopes = np.empty(self._dof)
        first_n = self._dof if together else self._left_n
        fill_slopes(q, v, self._deceleration, self.limits, first_n, slopes)
        return slopes

    def rest(self, q: Array, v: Array, slopes: Array) -> Array:
        """Return the posture (n,) in which joints at q, v come to rest."""
        rest = np.empty(self._dof)
        fill_rest(q, np.clip(v, -self._v_max, self._v_max), slopes, self.limits, rest)
        return rest


class BrakingProfile:
    """Joint reference from q, v (n,) to rest, one control step at a time.

    Attributes:
        q, v, a: Reference (n,) [rad], [rad/s], [rad/s^2].
        duration_s: Time to rest.
    """

    def __init__(
        self,
        law: BrakingLaw,
        q: Array,
        v: Array,
        slopes: Array,
        dt_s: float,
    ) -> None:
        self._limits = law.limits
        self._dt = dt_s
        self._v_0 = v
        self._slope_max = slopes
        self._left = np.ones(len(q))
        # Where the ramp would end beyond a position limit, the deceleration begins in full.
        room = np.where(v > 0.0, self._limits[1] - q, q - self._limits[0])
        close = np.abs(v) * (0.5 / slopes + 0.5 * RAMP_S) > room
        self._slope = np.where(close, slopes, 0.0)
        self.q = q.copy()
        self.v = v.copy()
        self.a = np.zeros(len(q))
        self.duration_s = float((1.0 / slopes).max()) + RAMP_S

    def step(self) -> None:
        """Move the reference on by one control step."""
        rise = self._slope + self._slope_max * self._dt / RAMP_S
        fall = np.sqrt(
            2.0 * self._left * self._slope_max / RAMP_S
        )  # slope and r reach zero together
        self._slope = np.minimum(np.minimum(rise, fall), self._slope_max)
        self._left = np.maximum(0.0, self._left - self._slope * self._dt)
        self.v = self._left * self._v_0
        self.a = -self._slope * self._v_0
        self.q = np.clip(self.q + self._dt * self.v, self._limits[0], self._limits[1])
