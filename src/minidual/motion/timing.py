"""Give a path times: the fastest ones inside velocity, acceleration and torque limits (toppra), then 1 kHz samples.

toppra keeps its limits at its grid points and may overshoot between them (1 to 4 % measured), so it is given
limits with headroom, and the sampled result is measured on a finer grid; what still overshoots is slowed down as a
whole, which can only lower velocities and accelerations.

toppra knows no jerk limit: its path acceleration jumps. So the path position s(t) is averaged over a short window
(a box filter). That leaves the path as it is, ends at rest at the same place, and makes the path acceleration
continuous: its rate is at most its largest jump divided by the window. What the joints' jerk still exceeds of its
limit is slowed down like the rest (a motion k times slower has 1/k^3 of the jerk).
"""

from __future__ import annotations

import functools
import math
import warnings
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from minidual.collision.errors import TimingError
from minidual.motion.smooth_path import SmoothPath
from minidual.motion.time_samples import time_samples
from minidual.proof.dynamics import torques
from minidual.proof.extremes import largest, motion_peaks
from minidual.robot.compiled import floats
from minidual.robot.constants import A_MAX, GROUPS, JERK_MAX, TAU_MAX, V_MAX, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.trajectory import Trajectory

DT_S = 0.001
_SLOWDOWNS_MAX = 12
_ROUNDING_TRIES = 20
_ROUNDING_GIVES = 1.0 - 5e-5


@dataclass(frozen=True, kw_only=True)
class MotionLimits:
    """Limits that a plan must keep, as fractions of the robot's own."""

    velocity_scale: float = 0.95
    acceleration_scale: float = 0.9
    torque_scale: float = 0.95
    jerk_scale: float = 0.95
    smoothing_s: float = 0.04
    """Window of the average over s(t); every trajectory gets that much longer."""


class Curve(Protocol):
    """A twice differentiable curve in joint space."""

    @property
    def length(self) -> float:
        """End of the parameter interval, which begins at 0."""
        ...

    @property
    def knots(self) -> Array:
        """Parameters (k,), first 0 and last `length`, between which the curve is smooth."""
        ...

    def at(self, s: Array, order: int = 0) -> Array:
        """Return the curve or a derivative at (n,) parameters, (n, d)."""
        ...


def time_path(path: Curve, group: str, limits: MotionLimits, kinematics: Kinematics) -> Trajectory:
    """Return the trajectory of a 14-joint curve within the scaled limits.

    Raises:
        TimingError: No time law keeps the limits.
    """
    joints = GROUPS[group]
    columns = np.arange(14)[joints]
    v_max, a_max = limits.velocity_scale * V_MAX[columns], limits.acceleration_scale * A_MAX[columns]
    s, sd = fastest_profile(path, columns, v_max, a_max)
    return drive(path, s, sd, group, limits, kinematics)[0]


def drive(
    path: Curve, s: Array, sd: Array, group: str, limits: MotionLimits, kinematics: Kinematics
) -> tuple[Trajectory, Array]:
    """Return the 1 kHz trajectory of a speed profile, slowed until it keeps the limits, and s (m,) at its samples.

    Raises:
        TimingError: It keeps them at no reasonable speed.
    """
    factor = 1.0
    most = np.array([limits.velocity_scale * V_MAX, limits.acceleration_scale * A_MAX, limits.jerk_scale * JERK_MAX])
    for _ in range(_SLOWDOWNS_MAX):
        times, *law = sample_parameters(s, sd, limits.smoothing_s)
        q, v, a = _driven(path, *law)
        factor = _slowdown_needed(v, a, most)
        if factor <= 1.0 + 1e-9:
            factor = _slowdown_for_torque(_torque_ratio(q, v, a, 8) / limits.torque_scale)
        if not factor > 1.0:  # a trajectory refuses NaN
            return Trajectory(times, q, v, a, group), law[0]
        sd = sd / (factor * 1.001)
    raise TimingError(f"the path still needs to be {factor:.3f} times slower after {_SLOWDOWNS_MAX} slow-downs")


def _slowdown_needed(v: Array, a: Array, most: Array) -> float:
    """Return how much slower samples (n, 14) every DT_S must be to keep speed, acceleration and jerk; NaN if one is.

    most: (3, 14), the limit of each.
    """
    speed, acceleration, jerk = (motion_peaks(v, a) / most).max(axis=1).tolist()
    roots = speed, math.sqrt(acceleration), math.cbrt(jerk / DT_S)
    return max(roots) if math.isfinite(sum(roots)) else math.nan


def _slowdown_for_torque(ratio: float) -> float:
    """Return how much slower to try: torque has a part that does not shrink with speed (gravity)."""
    return 1.0 if ratio <= 1.0 else float(1.0 + 0.25 * np.minimum(1.0, ratio - 1.0) + 0.02)


def torque_ratio(trajectory: Trajectory, every: int = 1) -> float:
    """Return the largest |torque| / limit along the trajectory, at one of `every` samples and the last one."""
    return _torque_ratio(trajectory.q, trajectory.v, trajectory.a, every)


def _torque_ratio(q: Array, v: Array, a: Array, every: int) -> float:
    rows = np.append(np.arange(0, len(q), every), len(q) - 1)
    return float(np.max(largest(torques(q[rows], v[rows], a[rows])) / TAU_MAX))


def fastest_profile(path: Curve, columns: Array, v_max: Array, a_max: Array) -> tuple[Array, Array]:
    """Return toppra's grid s (n,) and the path speed sd (n,) on it, at rest at both ends.

    Args:
        path: Curve of d columns.
        columns: The columns that are limited.
        v_max: Limit of each of them [unit/s].
        a_max: Limit of each of them [unit/s^2].

    Raises:
        TimingError: toppra finds no profile.
    """
    grid = _grid(path)
    solve = _solver(path, grid, columns, v_max, a_max).solve_stagewise_optim
    n, steps = len(grid), np.diff(grid)
    # Rest is always possible (x = 0, u = 0), so the controllable speeds begin at 0 and only their end is sought:
    # from behind, the largest x = sd^2 from which the next interval can be reached; then forwards, as fast as that
    # allows. The tiny weight on u breaks ties.
    most = [0.0] * n
    fastest, goal = np.array([[1e-9, -1.0], [0.0, -1.0]], dtype=object)  # plain floats are what toppra reads fastest
    nan = math.nan
    for i in range(n - 2, -1, -1):
        most[i] = solve(i, None, fastest, nan, nan, 0.0, most[i + 1])[1]
    x = [0.0] * n
    for i, step in enumerate(steps.tolist()):
        goal[0] = -2.0 * step
        u = solve(i, None, goal, x[i], x[i], 0.0, most[i + 1])[0]
        tries = _ROUNDING_TRIES
        while not math.isfinite(u) and tries > 1:  # x gives way by up to a thousandth to rounding
            x[i] *= _ROUNDING_GIVES
            u = solve(i, None, goal, x[i], x[i], 0.0, most[i + 1])[0]
            tries -= 1
        x[i + 1] = min(max(0.0, x[i] + 2.0 * step * u), most[i + 1])
    sd = np.sqrt(x)
    if not np.isfinite(sd).all() or (sd[1:-1] <= 0.0).any():
        raise TimingError("toppra found no time law for the path; it may be degenerate")
    return grid, sd


def _solver(path: Curve, grid: Array, columns: Array, v_max: Array, a_max: Array) -> Any:
    """Return toppra's stage-wise linear programs (Seidel's algorithm) for a path on a grid."""
    constraints = _constraints(tuple(v_max.tolist()), tuple(a_max.tolist()))
    from toppra.solverwrapper.cy_seidel_solverwrapper import seidelWrapper

    first, second = (path.at(grid, order)[:, columns] for order in (1, 2))
    return seidelWrapper(list(constraints), _OnGrid(first, second), grid, True)


class _OnGrid:
    """What toppra asks of a path: its derivatives on the grid, each computed once for all constraints."""

    def __init__(self, first: Array, second: Array) -> None:
        self._derivatives = {1: first, 2: second}
        self.dof = first.shape[1]

    def __call__(self, _grid: Array, order: int) -> Array:
        return self._derivatives[order]


@functools.lru_cache(maxsize=64)
def _constraints(v_max: tuple[float, ...], a_max: tuple[float, ...]) -> tuple[Any, Any]:
    """Return the limits as toppra's constraints, which are slow to make (each prints itself into a text)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SyntaxWarning)  # its docstrings hold unescaped backslashes
        import toppra
        from toppra.constraint import JointVelocityConstraint

    toppra.setup_logging("ERROR")
    v = np.array(v_max)
    return JointVelocityConstraint(np.column_stack([-v, v])), _accelerations()(np.array(a_max))


@functools.cache
def _accelerations() -> Any:
    """Return the class of toppra's acceleration limits, interpolated, but with what never changes made once."""
    from toppra.constraint import LinearConstraint

    class Accelerations(LinearConstraint):
        def __init__(self, a_max: Array) -> None:
            super().__init__()
            self.dof = len(a_max)
            self.identical = True  # F and g are the same at every point of the grid
            both_ways = np.vstack([np.eye(self.dof), -np.eye(self.dof)])
            self._F = np.kron(np.eye(2), both_ways)
            self._g = np.tile(a_max, 4)

        def compute_constraint_params(self, path: _OnGrid, gridpoints: Array) -> tuple[Any, ...]:
            """Return q' and q'' of a point and, as far as they follow from its u and x, of the next point."""
            d, first, second = self.dof, path(gridpoints, 1), path(gridpoints, 2)
            a, b = np.empty((2, len(gridpoints), 2 * d))
            a[:, :d], b[:, :d] = first, second
            a[:-1, d:] = first[1:] + 2.0 * np.diff(gridpoints)[:, None] * second[1:]
            b[:-1, d:] = second[1:]
            a[-1, d:], b[-1, d:] = first[-1], second[-1]
            return a, b, np.zeros_like(a), self._F, self._g, None, None

    return Accelerations


def _grid(path: Curve) -> Array:
    """Return grid points that hit every knot: at least 8 a piece, and no step longer than 1/100 of the path."""
    widths = np.diff(path.knots)
    counts = np.maximum(8, np.ceil(widths / (path.length / 100.0))).astype(int)
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    points = within * np.repeat(widths / counts, counts) + np.repeat(path.knots[:-1], counts)
    return np.append(points, path.length)


def sample_parameters(
    s: Array, sd: Array, smoothing_s: float = 0.0, dt_s: float = DT_S
) -> tuple[Array, Array, Array, Array]:
    """Return (times, s, ds/dt, d2s/dt2) on a regular grid of dt_s; the whole is stretched to end on it.

    The average over `smoothing_s` is a mean of shifted copies of s(t), so its derivatives are the same means of the
    shifted derivatives, exactly.

    Raises:
        TimingError: The profile never arrives.
    """
    position, speed, acceleration = time_samples(floats(s), floats(sd), dt_s, max(1, round(smoothing_s / dt_s)))
    if not len(position):
        raise TimingError("the path's speed profile takes no finite time")
    return np.arange(len(position)) * dt_s, position, speed, acceleration


def _driven(path: Curve, s: Array, speed: Array, acceleration: Array) -> tuple[Array, Array, Array]:
    """Return q, v and a, each (m, 14), of the first 14 columns of a curve, passed at the given parameters (m,)."""
    if isinstance(path, SmoothPath):
        return path.driven(s, speed, acceleration)
    q, first, second = (np.ascontiguousarray(path.at(s, order)[:, :14]) for order in range(3))
    v = first * speed[:, None]
    return q, v, second * speed[:, None] ** 2 + first * acceleration[:, None]
