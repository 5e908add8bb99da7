"""Samples of a speed profile on a regular grid of time."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numba.core import types

from minidual.robot.compiled import ROWS, VECTOR, kernel
from minidual.robot.constants import Array

_STEPS_MAX = 1e8
"""Above this a profile counts as endless."""


@njit
def _average(values: Array, n: int, copies: int, at_end: float, sums: Array) -> None:
    """Put the mean of a signal (n + 1,) and its delayed copies in its place; before its start it is 0."""
    sums[: copies + 1] = total = 0.0
    for k in range(n + copies):
        total += values[k] if k <= n else at_end
        sums[copies + 1 + k] = total
    for k in range(n + copies - 1):
        values[k] = (sums[k + copies + 1] - sums[k + 1]) / copies
    values[n + copies - 1] = at_end


@kernel(ROWS(VECTOR, VECTOR, types.float64, types.int64))
def time_samples(s: Array, sd: Array, dt_s: float, copies: int) -> Array:
    """Return (3, m): s, ds/dt and d2s/dt2 every dt_s, averaged with copies delayed by 1, 2, ... samples.

    The path acceleration is constant between two points of the grid; the whole is stretched to end on a sample.

    Args:
        s: Grid (k,), k >= 2.
        sd: Path speed (k,) at it.
        dt_s: Step [s].
        copies: How many are averaged, itself included.

    Returns:
        Nothing, (3, 0), if it takes no finite time.
    """
    passed = np.empty(len(s))  # when each point is passed
    passed[0] = 0.0
    for i in range(len(s) - 1):
        passed[i + 1] = passed[i] + 2.0 * (s[i + 1] - s[i]) / (sd[i + 1] + sd[i])
    steps = math.ceil(passed[-1] / dt_s - 1e-9) if passed[-1] / dt_s < _STEPS_MAX else -1
    if not steps >= 0:
        return np.empty((3, 0))
    n = max(1, steps)
    stretch = n * dt_s / passed[-1]
    out = np.empty((3, n + copies))
    position, speed, acceleration = out[0], out[1], out[2]
    i = 0
    for k in range(n + 1):
        t = k * dt_s / stretch
        while i < len(s) - 2 and passed[i + 1] <= t:
            i += 1
        u = (sd[i + 1] * sd[i + 1] - sd[i] * sd[i]) / (2.0 * (s[i + 1] - s[i]))
        x = t - passed[i]
        at = s[i] + sd[i] * x + 0.5 * u * (x * x)
        rate = sd[i] + u * x
        position[k] = 0.0 if at < 0.0 else s[-1] if at > s[-1] else at
        speed[k] = (0.0 if rate < 0.0 else rate) / stretch
        acceleration[k] = u / (stretch * stretch)
    position[n], speed[n] = s[-1], 0.0
    if copies > 1:
        acceleration[n] = 0.0  # at rest from here on
        sums = np.empty(n + 2 * copies + 1)
        _average(position, n, copies, s[-1], sums)
        _average(speed, n, copies, 0.0, sums)
        _average(acceleration, n, copies, 0.0, sums)
    return out
