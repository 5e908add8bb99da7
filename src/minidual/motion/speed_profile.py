"""The fastest speed along a path within velocity and acceleration limits.

The method is TOPP-RA (Pham and Pham, "A New Approach to Time-Optimal Path Parameterization Based on Reachability
Analysis", 2018): with x = (ds/dt)^2 and u = d2s/dt2, constant between grid points, every limit is linear in u and x.
Backwards, the largest x from which the next interval can be reached; forwards, the largest u. Accelerations are limited
at both ends of each interval. The tests hold the result to the `toppra` package, which takes 2 s to import.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from minidual.robot.compiled import ROWS, VECTOR, kernel
from minidual.robot.pair import Array

_STEPS_MAX = 200
_FLAT = 1e-12


@njit
def _range(rows: Array, limits: Array, goal: float, step: float, x: float) -> tuple[float, float, float, float]:
    """Return (u_low, u_high) at x and their slopes over x; rows (r, 2): |rows[k, 0] u + rows[k, 1] x| <= limits[k].

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
    """Fill the acceleration rows (2 d, 2) of the interval that begins at grid point i."""
    d = first.shape[1]
    for j in range(d):
        out[j, 0], out[j, 1] = first[i, j], second[i, j]
        out[d + j, 0] = first[i + 1, j] + 2.0 * step * second[i + 1, j]
        out[d + j, 1] = second[i + 1, j]


@kernel(VECTOR(VECTOR, ROWS, ROWS, VECTOR, VECTOR))
def squared_speeds(grid: Array, first: Array, second: Array, v_max: Array, a_max: Array) -> Array:
    """Return (ds/dt)^2 (n,) on the grid (n,), at rest at both ends.

    Args:
        grid: Parameters, increasing.
        first: First derivatives of the path by s, (n, d).
        second: Second derivatives, (n, d).
        v_max: Limits of the d columns [unit/s].
        a_max: Limits of the d columns [unit/s^2].
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
        # The width of the range of u is concave over x and positive at 0: Newton's method from above finds its root.
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
