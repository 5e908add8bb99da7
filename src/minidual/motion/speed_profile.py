"""Fastest path speed within velocity and acceleration limits by TOPP-RA (Pham and Pham, 2018).

x = (ds/dt)^2 and u = d2s/dt2 (constant per interval) make all limits linear; accelerations are limited at both interval
ends.
"""

import numpy as np
from numba import njit

from minidual.robot.compiled import ROWS, VECTOR, kernel
from minidual.robot.pair import Array

_STEPS_MAX = 200
_FLAT = 1e-12


@njit
def _range(rows: Array, limits: Array, goal: float, step: float, x: float) -> tuple[float, float, float, float]:
    """Return (u_low, u_high) at x and their slopes; rows (r, 2): |rows[k, 0] u + rows[k, 1] x| <= limits[k].

    The next x, x + 2 step u, must lie in [0, goal].
    """
    low, high = -x / (2.0 * step), (goal - x) / (2.0 * step)
    low_slope = high_slope = -0.5 / step
    for k in range(len(limits)):
        a, b = rows[k, 0], rows[k, 1]
        if abs(a) <= _FLAT:
            continue
        slope, most = -b / a, limits[k] / abs(a)
        if not slope * x - most <= low:
            low, low_slope = slope * x - most, slope
        if not slope * x + most >= high:
            high, high_slope = slope * x + most, slope
    return low, high, low_slope, high_slope


@njit
def _rows(first: Array, second: Array, i: int, step: float, out: Array) -> None:
    """Fill the acceleration rows (2 d, 2) of interval i."""
    d = first.shape[1]
    for j in range(d):
        out[j, 0], out[j, 1] = first[i, j], second[i, j]
        out[d + j, 0] = first[i + 1, j] + 2.0 * step * second[i + 1, j]
        out[d + j, 1] = second[i + 1, j]


@kernel(VECTOR(VECTOR, ROWS, ROWS, VECTOR, VECTOR))
def squared_speeds(grid: Array, first: Array, second: Array, v_max: Array, a_max: Array) -> Array:
    """Return (ds/dt)^2 on the grid (n,), zero at both ends.

    Path derivatives are (n, d), limits (d,) [unit/s], [unit/s^2].
    """
    n, d = first.shape
    most, rows = np.zeros(n), np.empty((2 * d, 2))
    limits = np.concatenate((a_max, a_max))
    for i in range(n - 2, -1, -1):
        step = grid[i + 1] - grid[i]
        _rows(first, second, i, step, rows)
        x = np.inf
        for j in range(d):
            if abs(first[i, j]) > 0.0:
                x = min(x, (v_max[j] / first[i, j]) ** 2)
        for k in range(2 * d):
            if abs(rows[k, 0]) <= _FLAT and abs(rows[k, 1]) > 0.0:
                x = min(x, limits[k] / abs(rows[k, 1]))
        x = min(x, 1e12)
        # The width of the u range is concave in x and positive at 0, so Newton's method from above converges.
        for _ in range(_STEPS_MAX):
            low, high, low_slope, high_slope = _range(rows, limits, most[i + 1], step, x)
            if high >= low:
                break
            lower = x + (high - low) / (low_slope - high_slope)
            if not 0.0 <= lower < x:
                x = max(0.0, lower) if lower < x else x
                break
            x = lower
        most[i] = x
    found = np.zeros(n)
    for i in range(n - 1):
        step = grid[i + 1] - grid[i]
        _rows(first, second, i, step, rows)
        _, high, _, _ = _range(rows, limits, most[i + 1], step, found[i])
        found[i + 1] = min(max(0.0, found[i] + 2.0 * step * high), most[i + 1])
    return found
