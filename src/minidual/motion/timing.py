"""Time parametrization within velocity, acceleration, jerk and torque limits, at 1 kHz.

The speed profile exceeds its limits by 1 to 4 % between grid points, so it is slowed down as a whole. Averaging s(t)
over a window bounds jerk; k times slower means 1/k^3 of it.
"""

import math
from typing import Protocol

import numpy as np
from pydantic import Field

from minidual.collision.errors import TimingError
from minidual.config.base import StrictModel
from minidual.config.planning import MotionLimits
from minidual.motion.speed_profile import squared_speeds
from minidual.robot.compiled import floats
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Indices
from minidual.robot.trajectory import Trajectory, largest

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
    path: Curve, group: str, limits: MotionLimits, kinematics: Kinematics, along: PathLimits | None = None
) -> tuple[Trajectory, Array]:
    """Return the trajectory of a curve and s at its samples; `along` limits the columns after the joints.

    Raises:
        TimingError: The limits cannot be kept.
    """
    robot = kinematics.robot
    columns = np.arange(robot.dof)[robot.groups[group]]
    v_max, a_max = limits.velocity_scale * robot.v_max[columns], limits.acceleration_scale * robot.a_max[columns]
    if along is not None:
        others = np.arange(robot.dof, path.at(path.knots[:1]).shape[1])
        columns = np.append(columns, others)
        v_max = np.append(v_max, np.full(len(others), along.speed_m_per_s))
        a_max = np.append(a_max, np.full(len(others), along.acceleration_m_per_s2))
    s, sd = fastest_profile(path, columns, v_max, a_max)
    return drive(path, s, sd, group, limits, kinematics)


def resting(q: Array, duration_s: float, group: str) -> Trajectory:
    """Return the trajectory that stays at q (n,)."""
    still = np.zeros((2, len(q)))
    return Trajectory(np.array([0.0, duration_s]), np.array([q, q]), still, still.copy(), group)


def drive(
    path: Curve, s: Array, sd: Array, group: str, limits: MotionLimits, kinematics: Kinematics
) -> tuple[Trajectory, Array]:
    """Return the 1 kHz trajectory of profile sd (n,) on s (n,), slowed to the limits, and s at its samples.

    Raises:
        TimingError: That does not suffice.
    """
    robot, factor = kinematics.robot, 1.0
    v_max, a_max = limits.velocity_scale * robot.v_max, limits.acceleration_scale * robot.a_max
    jerk_max = limits.jerk_scale * robot.jerk_max
    for _ in range(_SLOWDOWNS_MAX):
        times, at, speed, acceleration = sample_parameters(s, sd, limits.smoothing_s)
        q, first, second = (path.at(at, order)[:, : robot.dof] for order in range(3))
        v = first * speed[:, None]
        a = second * speed[:, None] ** 2 + first * acceleration[:, None]
        # np.maximum propagates NaN, and Trajectory refuses it.
        factor = float(np.max(largest(v) / v_max))
        factor = np.maximum(factor, math.sqrt(np.max(largest(a) / a_max)))
        factor = np.maximum(factor, math.cbrt(np.max(largest(np.diff(a, axis=0)) / jerk_max) / DT_S))
        if factor <= 1.0 + 1e-9:
            ratio = torque_ratio(q, v, a, kinematics) / limits.torque_scale
            # Gravity torque does not shrink with speed, so the steps are small.
            factor = 1.0 if ratio <= 1.0 else 1.02 + 0.25 * np.minimum(1.0, ratio - 1.0)
        if not factor > 1.0:
            return Trajectory(times, q, v, a, group), at
        sd = sd / (factor * 1.001)
    raise TimingError(f"the path still needs to be {factor:.3f} times slower after {_SLOWDOWNS_MAX} slow-downs")


def torque_ratio(q: Array, v: Array, a: Array, kinematics: Kinematics, every: int = _TORQUE_EVERY) -> float:
    """Return the largest |torque| / limit of every `every`-th state (n, dof) and the last."""
    rows = np.append(np.arange(0, len(q), every), len(q) - 1)
    return float(np.max(largest(kinematics.torques(q[rows], v[rows], a[rows])) / kinematics.robot.tau_max))


def fastest_profile(path: Curve, columns: Indices, v_max: Array, a_max: Array) -> tuple[Array, Array]:
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
    points = within * np.repeat(widths / counts, counts) + np.repeat(path.knots[:-1], counts)
    return np.append(points, path.length)


def sample_parameters(
    s: Array, sd: Array, smoothing_s: float = 0.0, dt_s: float = DT_S
) -> tuple[Array, Array, Array, Array]:
    """Return (times, s, ds/dt, d2s/dt2) every dt_s, stretched to whole steps.

    Averaged over `smoothing_s` as a mean of delayed copies: derivatives are exact.

    Raises:
        TimingError: The duration is too long.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        passed = np.append(0.0, np.cumsum(2.0 * np.diff(s) / (sd[1:] + sd[:-1])))
    if not passed[-1] / dt_s < _STEPS_MAX:
        raise TimingError("the path's speed profile takes no finite time")
    n = max(1, math.ceil(passed[-1] / dt_s - 1e-9))
    stretch = n * dt_s / passed[-1]
    t = np.arange(n + 1) * dt_s / stretch
    i = np.clip(np.searchsorted(passed, t, side="right") - 1, 0, len(s) - 2)
    u = ((sd[1:] ** 2 - sd[:-1] ** 2) / (2.0 * np.diff(s)))[i]
    x = t - passed[i]
    position = np.clip(s[i] + sd[i] * x + 0.5 * u * (x * x), 0.0, s[-1])
    speed, acceleration = np.maximum(0.0, sd[i] + u * x) / stretch, u / stretch**2
    position[-1], speed[-1] = s[-1], 0.0
    copies = max(1, round(smoothing_s / dt_s))
    if copies > 1:
        acceleration[-1] = 0.0  # at rest afterwards
        position = _averaged(position, copies, s[-1])
        speed, acceleration = _averaged(speed, copies, 0.0), _averaged(acceleration, copies, 0.0)
    return np.arange(len(position), dtype=float) * dt_s, position, speed, acceleration


def _averaged(values: Array, copies: int, end: float) -> Array:
    """Mean of delayed copies; values are 0 before and `end` after."""
    sums = np.cumsum(np.concatenate([np.zeros(copies), values, np.full(copies - 1, end)]))
    out = (sums[copies:] - sums[:-copies]) / copies
    out[-1] = end
    return out
