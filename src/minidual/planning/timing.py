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
import warnings
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from minidual.planning.dynamics import torques
from minidual.planning.errors import TimingError
from minidual.planning.trajectory import Trajectory
from minidual.robot.constants import A_MAX, GROUPS, JERK_MAX, TAU_MAX, V_MAX, Array
from minidual.robot.kinematics import Kinematics

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
    for _ in range(_SLOWDOWNS_MAX):
        times, position, speed, acceleration = sample_parameters(s, sd, limits.smoothing_s)
        trajectory = _along(path, times, position, speed, acceleration, group)
        factor = _slowdown_needed(trajectory, limits)
        if factor <= 1.0:
            return trajectory, position
        sd = sd / (factor * 1.001)
    raise TimingError(
        f"the path still needs to be {factor:.3f} times slower after {_SLOWDOWNS_MAX} slow-downs"
    )


def _slowdown_needed(trajectory: Trajectory, limits: MotionLimits) -> float:
    velocity = float(np.max(np.abs(trajectory.v) / (limits.velocity_scale * V_MAX)))
    acceleration = float(np.max(np.abs(trajectory.a) / (limits.acceleration_scale * A_MAX)))
    jerk = float(np.max(np.abs(np.diff(trajectory.a, axis=0)) / (limits.jerk_scale * JERK_MAX)))
    factor = max(velocity, np.sqrt(acceleration), np.cbrt(jerk / trajectory.dt_s))
    if factor > 1.0 + 1e-9:
        return float(factor)
    # Torque has a part that does not shrink with speed (gravity), so it is lowered step by step.
    torque = torque_ratio(trajectory, every=8) / limits.torque_scale
    return 1.0 if torque <= 1.0 else 1.0 + 0.25 * min(1.0, torque - 1.0) + 0.02


def torque_ratio(trajectory: Trajectory, every: int = 1) -> float:
    """Return the largest |torque| / limit along the trajectory, at one of `every` samples and the last one."""
    rows = np.append(np.arange(0, len(trajectory.times), every), len(trajectory.times) - 1)
    tau = torques(trajectory.q[rows], trajectory.v[rows], trajectory.a[rows])
    return float(np.max(np.abs(tau) / TAU_MAX))


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
    solver = _solver(path, grid, columns, v_max, a_max)
    n = len(grid)
    # Rest is always possible (x = 0, u = 0), so the controllable speeds begin at 0 and only their end is sought:
    # from behind, the largest x = sd^2 from which the next interval can be reached; then forwards, as fast as that
    # allows. The tiny weight on u breaks ties.
    most = np.zeros(n)
    fastest = np.array([1e-9, -1.0])
    nan = float("nan")
    solver.setup_solver()
    for i in range(n - 2, -1, -1):
        most[i] = solver.solve_stagewise_optim(i, None, fastest, nan, nan, 0.0, most[i + 1])[1]
    x = np.zeros(n)
    for i, delta in enumerate(np.diff(grid)):
        u = _largest_u(solver, i, float(delta), x, most)
        x[i + 1] = min(max(0.0, x[i] + 2.0 * delta * u), most[i + 1])
    solver.close_solver()
    sd = np.sqrt(x)
    if not np.isfinite(sd).all() or (sd[1:-1] <= 0.0).any():
        raise TimingError("toppra found no time law for the path; it may be degenerate")
    return grid, sd


def _largest_u(solver: Any, i: int, delta: float, x: Array, most: Array) -> float:
    """Return the largest path acceleration from x[i]; x[i] gives way by up to a thousandth to rounding."""
    goal = np.array([-2.0 * delta, -1.0])
    for _ in range(_ROUNDING_TRIES):
        u = solver.solve_stagewise_optim(i, None, goal, x[i], x[i], 0.0, most[i + 1])[0]
        if np.isfinite(u):
            return float(u)
        x[i] *= _ROUNDING_GIVES
    return float("nan")


def _solver(path: Curve, grid: Array, columns: Array, v_max: Array, a_max: Array) -> Any:
    """Return toppra's stage-wise linear programs (Seidel's algorithm) for a path on a grid."""
    constraints = _constraints(tuple(v_max.tolist()), tuple(a_max.tolist()))
    from toppra.solverwrapper.cy_seidel_solverwrapper import seidelWrapper

    return seidelWrapper(list(constraints), _adapter(path, columns), grid, True)


@functools.lru_cache(maxsize=64)
def _constraints(v_max: tuple[float, ...], a_max: tuple[float, ...]) -> tuple[Any, Any]:
    """Return the limits as toppra's constraints, which are slow to make (each prints itself into a text)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SyntaxWarning)  # its docstrings hold unescaped backslashes
        import toppra
        from toppra.constraint import DiscretizationType, JointAccelerationConstraint, JointVelocityConstraint

    toppra.setup_logging("ERROR")
    v, a = np.array(v_max), np.array(a_max)
    velocity = JointVelocityConstraint(np.column_stack([-v, v]))
    acceleration = JointAccelerationConstraint(
        np.column_stack([-a, a]), discretization_scheme=DiscretizationType.Interpolation
    )
    return velocity, acceleration


def _grid(path: Curve) -> Array:
    """Return grid points that hit every knot: at least 8 a piece, and no step longer than 1/100 of the path."""
    longest = path.length / 100.0
    parts = [
        np.linspace(a, b, max(8, int(np.ceil((b - a) / longest))) + 1)[:-1]
        for a, b in zip(path.knots[:-1], path.knots[1:], strict=True)
    ]
    return np.append(np.concatenate(parts), path.length)


def _adapter(path: Curve, columns: Array) -> Any:
    from toppra.interpolator import AbstractGeometricPath

    class Adapter(AbstractGeometricPath):
        def __call__(self, s: Any, order: int = 0) -> Array:
            out = path.at(np.atleast_1d(s), order)[:, columns]
            return out if np.ndim(s) else out[0]

        @property
        def dof(self) -> int:
            return len(columns)

        @property
        def path_interval(self) -> Array:
            return np.array([0.0, path.length])

        @property
        def waypoints(self) -> None:
            return None

    return Adapter()


def profile_times(s: Array, sd: Array) -> Array:
    """Return the time (n,) [s] at which each grid point is passed: the path acceleration is constant between."""
    return np.concatenate([[0.0], np.cumsum(2.0 * np.diff(s) / (sd[1:] + sd[:-1]))])


def sample_parameters(
    s: Array, sd: Array, smoothing_s: float = 0.0, dt_s: float = DT_S
) -> tuple[Array, Array, Array, Array]:
    """Return (times, s, ds/dt, d2s/dt2) on a regular grid of dt_s; the whole is stretched to end on it.

    The average over `smoothing_s` is a mean of shifted copies of s(t), so its derivatives are the same means of the
    shifted derivatives, exactly.
    """
    at_grid = profile_times(s, sd)
    n = max(1, int(np.ceil(at_grid[-1] / dt_s - 1e-9)))
    stretch = n * dt_s / at_grid[-1]
    t = np.arange(n + 1) * dt_s / stretch
    i = np.clip(np.searchsorted(at_grid, t, side="right") - 1, 0, len(s) - 2)
    u = (sd[i + 1] ** 2 - sd[i] ** 2) / (2.0 * (s[i + 1] - s[i]))
    x = t - at_grid[i]
    position = np.clip(s[i] + sd[i] * x + 0.5 * u * x**2, 0.0, s[-1])
    speed = np.maximum(0.0, sd[i] + u * x) / stretch
    acceleration = u / stretch**2
    position[-1], speed[-1] = s[-1], 0.0
    copies = max(1, round(smoothing_s / dt_s))
    if copies > 1:
        acceleration[-1] = 0.0  # at rest from here on
        position = _mean_of_copies(position, copies, s[-1])
        speed = _mean_of_copies(speed, copies, 0.0)
        acceleration = _mean_of_copies(acceleration, copies, 0.0)
    return np.arange(len(position)) * dt_s, position, speed, acceleration


def _mean_of_copies(values: Array, copies: int, at_end: float) -> Array:
    """Return the mean of the signal and its copies delayed by 1, 2, ... samples; before the start it is 0."""
    padded = np.concatenate([np.zeros(copies), values, np.full(copies - 1, at_end)])
    total = np.concatenate([[0.0], np.cumsum(padded)])
    means = (total[copies + 1 :] - total[1:-copies]) / copies
    means[-1] = at_end
    return means


def _along(
    path: Curve, times: Array, position: Array, speed: Array, acceleration: Array, group: str
) -> Trajectory:
    """Return the trajectory of the first 14 columns of a curve, passed at the given parameters (m,)."""
    first, second = path.at(position, 1)[:, :14], path.at(position, 2)[:, :14]
    q = path.at(position)[:, :14]
    v = first * speed[:, None]
    a = second * speed[:, None] ** 2 + first * acceleration[:, None]
    return Trajectory(times, q, v, a, group)
