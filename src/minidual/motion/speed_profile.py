"""The fastest speed along a path, and its samples at 1 kHz.

The profile is that of TOPP-RA (Pham and Pham, 2018): x = (ds/dt)^2 and u = d2s/dt2 (constant per
interval) make velocity and acceleration limits linear; accelerations are limited at both interval
ends. Between grid points it exceeds its limits by 1 to 4 %.
"""

import math
from typing import NamedTuple, Protocol

import numpy as np
from numba import njit

from minidual.collision.errors import TimingError
from minidual.robot.compiled import ROWS, VECTOR, floats, kernel
from minidual.robot.pair import Array, Indices

DT_S = 0.001
_STEPS_MAX = 1e8
"""More samples are an error."""
_NEWTON_STEPS_MAX = 200
_FLAT = 1e-12
_SPEED_SQUARED_MAX = 1e12


class Curve(Protocol):
    """Twice differentiable; s from 0 to `length`."""

    @property
    def length(self) -> float:
        """End of s."""
        ...

    @property
    def knots(self) -> Array:
        """Parameters (k,), smooth in between."""
        ...

    def at(self, s: Array, order: int = 0) -> Array:
        """Return the curve or a derivative, (n, d)."""
        ...


class PathSamples(NamedTuple):
    """Motion along a path, every `DT_S`.

    Attributes:
        times: (n,) [s].
        s: Path parameter (n,).
        speed: ds/dt (n,).
        acceleration: d2s/dt2 (n,).
    """

    times: Array
    s: Array
    speed: Array
    acceleration: Array


@njit
def _range(
    rows: Array,
    limits: Array,
    goal: float,
    step: float,
    x: float,
) -> tuple[float, float, float, float]:
    """Return the least and greatest u at x, and their slopes over x.

    Rows (r, 2) mean |rows[k, 0] u + rows[k, 1] x| <= limits[k]. The next x, x + 2 step u, must lie
    in [0, goal].
    """
    low = -x / (2.0 * step)
    high = (goal - x) / (2.0 * step)
    low_slope = high_slope = -0.5 / step
    for k in range(len(limits)):
        a = rows[k, 0]
        b = rows[k, 1]
        if abs(a) <= _FLAT:
            continue
        slope = -b / a
        most = limits[k] / abs(a)
        if not slope * x - most <= low:
            low = slope * x - most
            low_slope = slope
        if not slope * x + most >= high:
            high = slope * x + most
            high_slope = slope
    return low, high, low_slope, high_slope


@njit
def _fill_rows(first: Array, second: Array, i: int, step: float, rows: Array) -> None:
    """Fill the acceleration rows (2 d, 2) of interval i: at its beginning, then at its end."""
    d = first.shape[1]
    for j in range(d):
        rows[j, 0] = first[i, j]
        rows[j, 1] = second[i, j]
        rows[d + j, 0] = first[i + 1, j] + 2.0 * step * second[i + 1, j]
        rows[d + j, 1] = second[i + 1, j]


@njit(error_model="numpy")
def _highest(
    rows: Array,
    limits: Array,
    goal: float,
    step: float,
    x: float,
) -> float:
    """Return the largest value up to x from which `goal` can be reached within the limits."""
    # The width of the u range is concave in x and positive at 0, so Newton's method from above
    # converges.
    for _ in range(_NEWTON_STEPS_MAX):
        low, high, low_slope, high_slope = _range(rows, limits, goal, step, x)
        if high >= low:
            break
        lower = x + (high - low) / (low_slope - high_slope)
        if not 0.0 <= lower < x:
            if lower < x:
                x = max(0.0, lower)
            break
        x = lower
    return x


@kernel(VECTOR(VECTOR, ROWS, ROWS, VECTOR, VECTOR), heap=True)
def squared_speeds(grid: Array, first: Array, second: Array, v_max: Array, a_max: Array) -> Array:
    """Return (ds/dt)^2 on the grid (n,), zero at both ends.

    Path derivatives are (n, d), limits (d,) [unit/s], [unit/s^2].
    """
    n, d = first.shape
    most = np.zeros(n)
    rows = np.empty((2 * d, 2))
    limits = np.concatenate((a_max, a_max))
    for i in range(n - 2, -1, -1):
        step = grid[i + 1] - grid[i]
        _fill_rows(first, second, i, step, rows)
        x = np.inf
        for j in range(d):
            if abs(first[i, j]) > 0.0:
                x = min(x, (v_max[j] / first[i, j]) ** 2)
        for k in range(2 * d):
            if abs(rows[k, 0]) <= _FLAT and abs(rows[k, 1]) > 0.0:
                x = min(x, limits[k] / abs(rows[k, 1]))
        x = min(x, _SPEED_SQUARED_MAX)
        most[i] = _highest(rows, limits, most[i + 1], step, x)
    profile = np.zeros(n)
    for i in range(n - 1):
        step = grid[i + 1] - grid[i]
        _fill_rows(first, second, i, step, rows)
        _, high, _, _ = _range(rows, limits, most[i + 1], step, profile[i])
        profile[i + 1] = min(max(0.0, profile[i] + 2.0 * step * high), most[i + 1])
    return profile


def fastest_profile(
    path: Curve,
    columns: Indices,
    v_max: Array,
    a_max: Array,
) -> tuple[Array, Array]:
    """Return a grid s (n,) and the fastest path speed on it, zero at both ends.

    `v_max` [unit/s] and `a_max` [unit/s^2] limit `columns`.

    Raises:
        TimingError: None exists.
    """
    grid = path_grid(path)
    first = floats(path.at(grid, 1)[:, columns])
    second = floats(path.at(grid, 2)[:, columns])
    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        raise TimingError("a derivative of the path is not finite")
    speeds = np.sqrt(squared_speeds(grid, first, second, floats(v_max), floats(a_max)))
    check_speeds(speeds)
    return grid, speeds


def check_speeds(speeds: Array) -> None:
    """Raise TimingError unless path speeds (n,) are finite and positive between the ends."""
    if not np.isfinite(speeds).all() or (speeds[1:-1] <= 0.0).any():
        raise TimingError("the path has no time law within the limits; it may be degenerate")


def path_grid(path: Curve) -> Array:
    """Return a grid with all knots and 8 or more steps between two, each at most 1/100 of s."""
    widths = np.diff(path.knots)
    counts = np.maximum(8, np.ceil(widths / (path.length / 100.0))).astype(int)
    starts = np.cumsum(counts) - counts
    within = np.arange(counts.sum()) - np.repeat(starts, counts)
    offsets = within * np.repeat(widths / counts, counts)
    return np.append(offsets + np.repeat(path.knots[:-1], counts), path.length)


def sample_parameters(s: Array, speeds: Array, smoothing_s: float = 0.0) -> PathSamples:
    """Return the samples of a speed profile, stretched to whole steps.

    Averaged over `smoothing_s` as a mean of delayed copies: derivatives are exact.

    Args:
        s: Grid (n,).
        speeds: ds/dt on it.
        smoothing_s: Averaging window [s].

    Raises:
        TimingError: The duration is too long.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        grid_times = np.append(0.0, np.cumsum(2.0 * np.diff(s) / (speeds[1:] + speeds[:-1])))
    if not grid_times[-1] / DT_S < _STEPS_MAX:
        raise TimingError("the path's speed profile takes no finite time")
    n = max(1, math.ceil(grid_times[-1] / DT_S - 1e-9))
    stretch = n * DT_S / grid_times[-1]
    t = np.arange(n + 1) * DT_S / stretch
    i = np.clip(np.searchsorted(grid_times, t, side="right") - 1, 0, len(s) - 2)
    u = ((speeds[1:] ** 2 - speeds[:-1] ** 2) / (2.0 * np.diff(s)))[i]
    x = t - grid_times[i]
    position = np.clip(s[i] + speeds[i] * x + 0.5 * u * (x * x), 0.0, s[-1])
    speed = np.maximum(0.0, speeds[i] + u * x) / stretch
    acceleration = u / stretch**2
    position[-1] = s[-1]
    speed[-1] = 0.0
    copies = max(1, round(smoothing_s / DT_S))
    if copies > 1:
        acceleration[-1] = 0.0  # at rest afterwards
        position = _averaged(position, copies, s[-1])
        speed = _averaged(speed, copies, 0.0)
        acceleration = _averaged(acceleration, copies, 0.0)
    times = np.arange(len(position), dtype=float) * DT_S
    return PathSamples(times, position, speed, acceleration)


def _averaged(values: Array, copies: int, end: float) -> Array:
    """Return the mean of delayed copies; values are 0 before and `end` after."""
    padded = np.concatenate([np.zeros(copies), values, np.full(copies - 1, end)])
    sums = np.cumsum(padded)
    means = (sums[copies:] - sums[:-copies]) / copies
    means[-1] = end
    return means
