"""Time parametrization by toppra, within velocity, acceleration and torque limits.

toppra (Pham and Pham, 2018) has no jerk limit, so its accelerations jump. They exceed their limits
by 1 to 4 % between grid points, so the profile is slowed down as a whole until its samples keep
them. Jumps are spread over 8 ms: within one step of 1 ms, the cubic between two samples overshoots
a jump by a third of it.

Importing toppra takes 4 s.
"""

import warnings
from typing import Any

import numpy as np

from minidual.collision.errors import TimingError
from minidual.config.planning import MotionLimits
from minidual.motion.speed_profile import Curve, check_speeds, path_grid
from minidual.motion.timing import (
    ColumnLimits,
    PathLimits,
    SpeedProfile,
    TimedPath,
    column_limits,
    slowed_down,
)
from minidual.motion.timing_engines import TimingEngine
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array

with warnings.catch_warnings():
    warnings.simplefilter("ignore", SyntaxWarning)  # unescaped backslashes in its docstrings
    from toppra.algorithm import TOPPRA
    from toppra.constraint import (
        DiscretizationType,
        JointAccelerationConstraint,
        JointTorqueConstraint,
        JointVelocityConstraint,
    )
    from toppra.interpolator import AbstractGeometricPath

_SPREAD_S = 0.008
_UNLIMITED = ("jerk", "torque_rate")
_NO_TORQUE_NM = 1.0


def time_path(
    path: Curve,
    group: str,
    limits: MotionLimits,
    kinematics: Kinematics,
    along: PathLimits | None = None,
) -> TimedPath:
    """Return the trajectory of a curve, whose first columns are all joints.

    `along` limits the columns after the joints; the jerk limit and `smoothing_s` have no effect.

    Raises:
        TimingError: The limits cannot be kept.
    """
    bounds = column_limits(path, group, limits, kinematics.robot, along)
    profile = _fastest_profile(path, bounds, limits.torque_scale, kinematics)
    spread = limits.model_copy(update={"smoothing_s": _SPREAD_S})
    return slowed_down(path, profile, group, spread, kinematics, _UNLIMITED)


ENGINE = TimingEngine(time_path, _UNLIMITED)


class _ColumnPath(AbstractGeometricPath):
    """Some columns of a curve, as toppra reads them."""

    def __init__(self, path: Curve, columns: Any) -> None:
        self._path = path
        self._columns = columns

    def __call__(self, path_positions: Any, order: int = 0) -> Array:
        values = self._path.at(np.atleast_1d(path_positions), order)[:, self._columns]
        return values if np.ndim(path_positions) else values[0]

    @property
    def dof(self) -> int:
        return len(self._columns)

    @property
    def path_interval(self) -> Array:
        return np.array([0.0, self._path.length])

    @property
    def waypoints(self) -> None:
        return None


def _fastest_profile(
    path: Curve,
    bounds: ColumnLimits,
    torque_scale: float,
    kinematics: Kinematics,
) -> SpeedProfile:
    """Return toppra's fastest path speed on the grid of `path_grid`."""
    scheme = DiscretizationType.Interpolation  # limits at both ends of each interval
    grid = path_grid(path)
    constraints = [
        JointVelocityConstraint(_both_signs(bounds.v_max)),
        JointAccelerationConstraint(_both_signs(bounds.a_max), scheme),
        _torque_constraint(path, bounds, torque_scale, kinematics, scheme),
    ]
    solver = TOPPRA(
        constraints,
        _ColumnPath(path, bounds.columns),
        gridpoints=grid,
        solver_wrapper="seidel",
    )
    parameterization = solver.compute_parameterization(0.0, 0.0)
    speeds = parameterization[1]
    if speeds is None:
        raise TimingError("toppra finds no time law within the limits")
    check_speeds(speeds)
    return SpeedProfile(grid, speeds)


def _both_signs(limits: Array) -> Array:
    """Return lower and upper limits (n, 2)."""
    return np.column_stack([-limits, limits])


def _torque_constraint(
    path: Curve,
    bounds: ColumnLimits,
    torque_scale: float,
    kinematics: Kinematics,
    scheme: DiscretizationType,
) -> JointTorqueConstraint:
    """Return the torque limits of the joints among the columns; the other columns have none."""
    robot = kinematics.robot
    joints_n = int(np.count_nonzero(bounds.columns < robot.dof))
    joints = bounds.columns[:joints_n]
    q_start = path.at(np.zeros(1))[0, : robot.dof]
    still = np.zeros(robot.dof)

    def torques(q_columns: Array, v_columns: Array, a_columns: Array) -> Array:
        q = q_start.copy()
        v = still.copy()
        a = still.copy()
        q[joints] = q_columns[:joints_n]
        v[joints] = v_columns[:joints_n]
        a[joints] = a_columns[:joints_n]
        tau = np.zeros(len(bounds.columns))
        tau[:joints_n] = kinematics.rnea(q, v, a)[joints]
        return tau

    tau_max = np.full(len(bounds.columns), _NO_TORQUE_NM)
    tau_max[:joints_n] = torque_scale * robot.tau_max[joints]
    frictions = np.zeros(len(bounds.columns))
    return JointTorqueConstraint(torques, _both_signs(tau_max), frictions, scheme)
