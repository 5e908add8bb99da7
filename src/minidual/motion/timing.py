"""Time parametrization within velocity, acceleration, jerk and torque limits, at 1 kHz.

The fastest path speed is that of TOPP-RA (Pham and Pham, 2018): x = (ds/dt)^2 and u = d2s/dt2 (constant per interval)
make all limits linear; accelerations are limited at both interval ends. It exceeds its limits by 1 to 4 % between grid
points, so it is slowed down as a whole. Averaging s(t) over a window bounds jerk; k times slower means 1/k^3 of it.
"""

import math
from typing import Protocol

import numpy as np
from numba import njit, types
from pydantic import Field

from minidual.collision.errors import TimingError
from minidual.config.base import StrictModel
from minidual.config.planning import MotionLimits
from minidual.robot.compiled import ROWS, VECTOR, floats, kernel
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Indices
from minidual.robot.trajectory import Trajectory

_NEWTON_STEPS_MAX = 200
_FLAT = 1e-12


@njit
def _range(
    rows: Array,
    limits: Array,
    goal: float,
    step: float,
    x: float,
) -> tuple[float, float, float, float]:
    """Return (u_low, u_high) at x and their slopes; rows (r, 2): |rows[k, 0] u + rows[k, 1] x| <= limits[k].

    The next x, x + 2 step u, must lie in [0, goal].
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
def _rows(first: Array, second: Array, i: int, step: float, out: Array) -> None:
    """Fill the acceleration rows (2 d, 2) of interval i."""
    d = first.shape[1]
    for j in range(d):
        out[j, 0], out[j, 1] = first[i, j], second[i, j]
        out[d + j, 0] = first[i + 1, j] + 2.0 * step * second[i + 1, j]
        out[d + j, 1] = second[i + 1, j]


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
        for _ in range(_NEWTON_STEPS_MAX):
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


DT_S = 0.001
_SLOWDOWNS_MAX = 12
_STEPS_MAX = 1e8
"""More samples are an error."""
_TORQUE_EVERY = 8


class PathLimits(StrictModel):
    """Limits along a path in space and of each coordinate; one radian counts as 0.2 m."""

    speed_m_per_s: float = Field(default=0.3, gt=0.0)
    acceleration_m_per_s2: float = Field(default=1.0, gt=0.0)


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


def time_path(
    path: Curve,
    group: str,
    limits: MotionLimits,
    kinematics: Kinematics,
    along: PathLimits | None = None,
) -> tuple[Trajectory, Array]:
    """Return the 1 kHz trajectory of a curve and s at its samples; `along` limits the columns after the joints.

    Raises:
        TimingError: The limits cannot be kept.
    """
    robot = kinematics.robot
    factor = 1.0
    v_max = limits.velocity_scale * robot.v_max
    a_max = limits.acceleration_scale * robot.a_max
    most_allowed = np.stack([v_max, a_max, limits.jerk_scale * DT_S * robot.jerk_max])
    columns = np.arange(robot.dof)[robot.groups[group]]
    bounds = np.stack([v_max, a_max])[:, columns]
    if along is not None:
        others = np.arange(robot.dof, path.at(path.knots[:1]).shape[1])
        columns = np.append(columns, others)
        own = [along.speed_m_per_s], [along.acceleration_m_per_s2]
        bounds = np.hstack([bounds, np.repeat(own, len(others), axis=1)])
    s, sd = fastest_profile(path, columns, *bounds)
    for _ in range(_SLOWDOWNS_MAX):
        times, at, speed, acceleration = sample_parameters(s, sd, limits.smoothing_s)
        v, a, most = _motion(
            floats(path.at(at, 1)),
            floats(path.at(at, 2)),
            speed,
            acceleration,
            robot.dof,
        )
        speeds, accelerations, jumps = (
            float(share) for share in np.max(most / most_allowed, axis=1)
        )
        factor = max(speeds, math.sqrt(accelerations), math.cbrt(jumps))
        if not factor > 1.0 + 1e-9:
            q = path.at(at)[:, : robot.dof]
            ratio = (
                np.max(kinematics.torque_use(q, v, a, DT_S, _TORQUE_EVERY)) / limits.torque_scale
            )
            # Gravity torque does not shrink with speed, so the steps are small.
            factor = 1.02 + 0.25 * np.minimum(1.0, ratio - 1.0)
            if not ratio > 1.0:
                return Trajectory(times, q, v, a, group), at
        sd = sd / (factor * 1.001)
    raise TimingError(
        f"the path still needs to be {factor:.3f} times slower after {_SLOWDOWNS_MAX} slow-downs",
    )


@kernel(types.UniTuple(ROWS, 3)(ROWS, ROWS, VECTOR, VECTOR, types.intp), heap=True)
def _motion(
    first: Array,
    second: Array,
    speed: Array,
    acceleration: Array,
    dof: int,
) -> tuple[Array, Array, Array]:
    """Return velocities, accelerations (n, dof) and the largest of both and of the accelerations' changes (3, dof).

    Path derivatives are (n, d >= dof), path speed and acceleration (n,). NaN stays in v and a; `Trajectory` refuses it.
    """
    v = np.empty((len(speed), dof))
    a = np.empty((len(speed), dof))
    most = np.zeros((3, dof))
    for i in range(len(speed)):
        for j in range(dof):
            v[i, j] = first[i, j] * speed[i]
            a[i, j] = second[i, j] * (speed[i] * speed[i]) + first[i, j] * acceleration[i]
            most[0, j], most[1, j] = max(most[0, j], abs(v[i, j])), max(most[1, j], abs(a[i, j]))
            most[2, j] = max(most[2, j], abs(a[i, j] - (a[i - 1, j] if i else 0.0)))
    most[2] = np.maximum(most[2], np.abs(a[-1]))  # it rests before and after
    return v, a, most


def resting(q: Array, duration_s: float, group: str) -> Trajectory:
    """Return the trajectory that stays at q (n,)."""
    still = np.zeros((2, len(q)))
    return Trajectory(np.array([0.0, duration_s]), np.array([q, q]), still, still.copy(), group)


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
    grid = _grid(path)
    first, second = (floats(path.at(grid, order)[:, columns]) for order in (1, 2))
    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        raise TimingError("a derivative of the path is not finite")
    sd = np.sqrt(squared_speeds(grid, first, second, floats(v_max), floats(a_max)))
    if not np.isfinite(sd).all() or (sd[1:-1] <= 0.0).any():
        raise TimingError("the path has no time law within the limits; it may be degenerate")
    return grid, sd


def _grid(path: Curve) -> Array:
    """Return a grid with all knots, 8 or more steps between two, each at most 1/100 of the path."""
    widths = np.diff(path.knots)
    counts = np.maximum(8, np.ceil(widths / (path.length / 100.0))).astype(int)
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.append(
        within * np.repeat(widths / counts, counts) + np.repeat(path.knots[:-1], counts),
        path.length,
    )


def sample_parameters(
    s: Array,
    sd: Array,
    smoothing_s: float = 0.0,
) -> tuple[Array, Array, Array, Array]:
    """Return (times, s, ds/dt, d2s/dt2) every `DT_S`, stretched to whole steps.

    Averaged over `smoothing_s` as a mean of delayed copies: derivatives are exact.

    Raises:
        TimingError: The duration is too long.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        passed = np.append(0.0, np.cumsum(2.0 * np.diff(s) / (sd[1:] + sd[:-1])))
    if not passed[-1] / DT_S < _STEPS_MAX:
        raise TimingError("the path's speed profile takes no finite time")
    n = max(1, math.ceil(passed[-1] / DT_S - 1e-9))
    stretch = n * DT_S / passed[-1]
    t = np.arange(n + 1) * DT_S / stretch
    i = np.clip(np.searchsorted(passed, t, side="right") - 1, 0, len(s) - 2)
    u = ((sd[1:] ** 2 - sd[:-1] ** 2) / (2.0 * np.diff(s)))[i]
    x = t - passed[i]
    position = np.clip(s[i] + sd[i] * x + 0.5 * u * (x * x), 0.0, s[-1])
    speed = np.maximum(0.0, sd[i] + u * x) / stretch
    acceleration = u / stretch**2
    position[-1] = s[-1]
    speed[-1] = 0.0
    copies = max(1, round(smoothing_s / DT_S))
    if copies > 1:
        acceleration[-1] = 0.0  # at rest afterwards
        position = _averaged(position, copies, s[-1])
        speed = _averaged(speed, copies, 0.0)
        acceleration = _averaged(acceleration, copies, 0.0)
    return np.arange(len(position), dtype=float) * DT_S, position, speed, acceleration


def _averaged(values: Array, copies: int, end: float) -> Array:
    """Mean of delayed copies; values are 0 before and `end` after."""
    sums = np.cumsum(np.concatenate([np.zeros(copies), values, np.full(copies - 1, end)]))
    out = (sums[copies:] - sums[:-copies]) / copies
    out[-1] = end
    return out
