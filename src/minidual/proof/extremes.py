"""The largest values of a sampled trajectory, each in one pass over its samples.

Eight samples of 14 joints lie side by side in memory and are looked at together, so that the compiler can compare
several in one instruction. A NaN among them stays to the end: it must reach the check.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numba.core import types

from minidual.robot.compiled import VECTOR, floats, kernel
from minidual.robot.constants import DOF, Array

Q_MIN, Q_MAX, SPEED, ACCELERATION, CHANGE, JUMP, OFF_VELOCITY, OFF_ACCELERATION = range(8)
"""Rows of what `extremes` returns."""

_TOGETHER = 8
"""Samples that are looked at together."""
_LANES = _TOGETHER * DOF


@njit
def _more(most: float, x: float) -> float:
    """Return the larger of the two; NaN of either stays."""
    return most if (most >= x) | (most != most) else x


@njit
def _add(q: Array, v: Array, a: Array, h: float, most: Array, count: int) -> None:
    """Raise the maxima by `count` values, each with the same joint's next one."""
    for i in range(count):
        step, change = q[DOF + i] - q[i], abs(a[DOF + i] - a[i])
        mean_v, mean_a = 0.5 * (v[i] + v[DOF + i]), 0.5 * (a[i] + a[DOF + i])
        q_middle = 0.5 * (q[i] + q[DOF + i]) + 0.125 * h * (v[i] - v[DOF + i])
        v_middle = 1.5 * step / h - 0.5 * mean_v
        off_v = abs(6.0 * (step / h - mean_v) / h) - change
        off_a = abs((v[DOF + i] - v[i]) / h - mean_a) - 0.5 * change
        row = i
        most[row] = _more(_more(_more(most[row], -q[i]), -q_middle), -q[DOF + i])
        row = Q_MAX * _LANES + i
        most[row] = _more(_more(_more(most[row], q[i]), q_middle), q[DOF + i])
        row = SPEED * _LANES + i
        most[row] = _more(_more(_more(most[row], abs(v[i])), abs(v_middle)), abs(v[DOF + i]))
        row = ACCELERATION * _LANES + i
        most[row] = _more(_more(_more(most[row], abs(a[i])), abs(mean_a)), abs(a[DOF + i]))
        row = CHANGE * _LANES + i
        most[row] = _more(most[row], change)
        row = JUMP * _LANES + i
        most[row] = _more(most[row], abs(step))
        row = OFF_VELOCITY * _LANES + i
        most[row] = _more(most[row], off_v)
        row = OFF_ACCELERATION * _LANES + i
        most[row] = _more(most[row], off_a)


@kernel(types.void(VECTOR, VECTOR, VECTOR, types.float64, VECTOR))
def _extremes(q: Array, v: Array, a: Array, h: float, most: Array) -> None:
    """Raise the maxima by all samples, 14 values each, one after the other."""
    n = len(q) // DOF
    together = min(_TOGETHER, n - 1)
    for first in range(0, n - 1, together):
        k = min(first, n - 1 - together)  # the last block goes back rather than beyond the end
        own = slice(k * DOF, (k + together + 1) * DOF)
        _add(q[own], v[own], a[own], h, most, together * DOF)


def extremes(q: Array, v: Array, a: Array, h: float) -> Array:
    """Return (8, 14) extremes of each joint for samples (n, 14), n >= 2, every h [s]; NaN where a sample is NaN.

    Between two samples the position is their cubic (Hermite) and the acceleration linear; both, and the cubic's speed,
    are looked at in the middle, too.

    Rows: least and largest position [rad]; largest speed [rad/s] and acceleration [rad/s^2]; what the acceleration
    changes by from sample to sample [rad/s^2], and the position [rad]; by how much [rad/s^2] positions contradict
    velocities, and velocities accelerations (`minidual.proof.limits` tells how).
    """
    most = np.full((8, _TOGETHER, DOF), -np.inf)
    q, v, a = (floats(x).reshape(-1) for x in (q, v, a))
    _extremes(q, v, a, h, most.reshape(-1))
    out = most.max(axis=1)
    out[Q_MIN] *= -1.0
    return out


@kernel(types.void(VECTOR, VECTOR))
def _largest(x: Array, most: Array) -> None:
    """Raise the maxima by all values."""
    n = len(x) // DOF
    together = min(_TOGETHER, n)
    for first in range(0, n, together):
        k = min(first, n - together)
        own = x[k * DOF : (k + together) * DOF]
        for i in range(together * DOF):
            most[i] = _more(most[i], abs(own[i]))


def largest(x: Array) -> Array:
    """Return (14,) the largest |x| of each column of x (n, 14), n >= 1; NaN where one is NaN."""
    most = np.full((_TOGETHER, DOF), -np.inf)
    _largest(floats(x).reshape(-1), most.reshape(-1))
    return most.max(axis=0)


@kernel(types.void(VECTOR, VECTOR, VECTOR))
def _motion_peaks(v: Array, a: Array, most: Array) -> None:
    """Raise the maxima by all samples."""
    n = len(v) // DOF
    together = min(_TOGETHER, n - 1)
    for first in range(0, n - 1, together):
        k = min(first, n - 1 - together)
        v_own, a_own = v[k * DOF : (k + together + 1) * DOF], a[k * DOF : (k + together + 1) * DOF]
        for i in range(together * DOF):
            most[i] = _more(_more(most[i], abs(v_own[i])), abs(v_own[DOF + i]))
            row = _LANES + i
            most[row] = _more(_more(most[row], abs(a_own[i])), abs(a_own[DOF + i]))
            row = 2 * _LANES + i
            most[row] = _more(most[row], abs(a_own[DOF + i] - a_own[i]))


def motion_peaks(v: Array, a: Array) -> Array:
    """Return (3, 14) the largest |v|, |a| and change of a from one of the samples (n, 14), n >= 2, to the next."""
    most = np.full((3, _TOGETHER, DOF), -np.inf)
    _motion_peaks(floats(v).reshape(-1), floats(a).reshape(-1), most.reshape(-1))
    return most.max(axis=1)
