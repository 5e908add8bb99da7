"""Samples of a speed profile on a regular grid of time."""

from __future__ import annotations

import numpy as np
from numba import njit
from numba.core import types

from minidual.planning.compiled import ROWS, VECTOR, kernel
from minidual.robot.constants import Array


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


@kernel(ROWS(VECTOR, VECTOR, VECTOR, types.int64, types.float64, types.int64))
def time_samples(s: Array, sd: Array, passed: Array, n: int, dt_s: float, copies: int) -> Array:
    """Return (3, n + copies): s, ds/dt and d2s/dt2 every dt_s, averaged with copies delayed by 1, 2, ... samples.

    Args:
        s: Grid (k,) between whose points the path acceleration is constant.
        sd: Path speed (k,) at them.
        passed: Time (k,) [s] at which each is passed; the whole is stretched to take n dt_s.
        n: Steps before averaging.
        dt_s: Step [s].
        copies: How many are averaged, itself included.
    """
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
