"""Check a timed trajectory against the robot's limits, midway between samples too; torque at every fourth sample."""

from dataclasses import dataclass

import numpy as np
from numba.core import types

from minidual.robot.compiled import ROWS, floats, inlined, kernel
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.robot.trajectory import Trajectory, largest

_ROUNDING = 1e-9
_REST_RAD_S = 1e-6
_TORQUE_EVERY = 4
_MISFIT = 0.05  # share of the acceleration limit; plans of 300 stored queries reach 0.016


@dataclass(frozen=True)
class LimitUse:
    """Largest fraction of each limit, smallest distance to a position limit."""

    velocity_ratio: float
    acceleration_ratio: float
    jerk_ratio: float
    torque_ratio: float
    limit_margin_rad: float


def limit_use(trajectory: Trajectory, kinematics: Kinematics) -> tuple[LimitUse, str]:
    """Return the use, and the first broken limit ("" if none)."""
    robot, h, n = kinematics.robot, trajectory.dt_s, len(trajectory.q)
    found = np.empty((8, robot.dof))
    _extremes(*(floats(x) for x in (trajectory.q, trajectory.v, trajectory.a)), h, found)
    below, above, speed, acceleration, change, jump, off_velocity, off_acceleration = found
    rows = np.append(np.arange(0, n, _TORQUE_EVERY), n - 1)
    torques = kinematics.torques(*(x[rows] for x in (trajectory.q, trajectory.v, trajectory.a)))
    worst = {
        "velocity": speed / robot.v_max,
        "acceleration": acceleration / robot.a_max,
        "jerk": change / h / robot.jerk_max,
        "torque": largest(torques) / robot.tau_max,
    }
    margin = np.minimum(-below - robot.q_lower, robot.q_upper - above)
    use = LimitUse(
        **{f"{what}_ratio": float(of.max()) for what, of in worst.items()}, limit_margin_rad=float(margin.min())
    )
    names = robot.joint_names
    if not margin.min() >= -_ROUNDING:
        joint = int(np.argmin(margin))
        return use, f"{names[joint]} leaves its position limit by {-margin.min():.4f} rad"
    for what, ratios in worst.items():
        joint = int(np.argmax(ratios))
        if not ratios[joint] <= 1.0 + _ROUNDING:
            return use, f"{names[joint]} needs {ratios[joint]:.3f} of its {what} limit"
    at_ends = float(np.abs(trajectory.v[[0, -1]]).max())
    if not at_ends <= _REST_RAD_S:
        return use, f"the arms still move at {at_ends:.4f} rad/s at an end"
    if not jump.max() / h <= float(robot.v_max.max()) * (1.0 + 1e-6):
        return use, f"positions jump: {jump.max() / h:.2f} rad/s between two samples"
    for what, of, off in (("velocity", "positions", off_velocity), ("acceleration", "velocity", off_acceleration)):
        joint = int(np.argmax(off / robot.a_max))
        if not off[joint] <= _MISFIT * robot.a_max[joint]:
            return use, f"the {what} of {names[joint]} is not that of its {of}: {off[joint]:.2f} rad/s^2 off"
    return use, ""


@inlined
def _larger(x: float, y: float) -> float:
    return x if x > y or x != x else y  # NaN stays


@kernel(types.void(ROWS, ROWS, ROWS, types.float64, ROWS))
def _extremes(q: Array, v: Array, a: Array, h: float, most: Array) -> None:
    """Fill (8, dof): maxima of -q, q, |v|, |a|, change of a, step of q, mismatch of v, mismatch of a [rad/s^2].

    A cubic whose mean speed differs from the mean end speed accelerates by six times the difference over the step. The
    acceleration's change (for a, half of it) is subtracted. NaN propagates.
    """
    most[:] = -np.inf
    for i in range(len(q)):
        for j in range(q.shape[1]):
            most[0, j], most[1, j] = _larger(-q[i, j], most[0, j]), _larger(q[i, j], most[1, j])
            most[2, j], most[3, j] = _larger(abs(v[i, j]), most[2, j]), _larger(abs(a[i, j]), most[3, j])
        for j in range(q.shape[1] if i else 0):
            rise, change = q[i, j] - q[i - 1, j], abs(a[i, j] - a[i - 1, j])
            gain, mean_v = v[i, j] - v[i - 1, j], 0.5 * (v[i, j] + v[i - 1, j])
            mean_a = 0.5 * (a[i, j] + a[i - 1, j])
            q_middle, v_middle = 0.5 * (q[i, j] + q[i - 1, j]) - 0.125 * h * gain, 1.5 * rise / h - 0.5 * mean_v
            most[0, j], most[1, j] = _larger(-q_middle, most[0, j]), _larger(q_middle, most[1, j])
            most[2, j], most[3, j] = _larger(abs(v_middle), most[2, j]), _larger(abs(mean_a), most[3, j])
            most[4, j], most[5, j] = _larger(change, most[4, j]), _larger(abs(rise), most[5, j])
            most[6, j] = _larger(abs(6.0 * (rise / h - mean_v) / h) - change, most[6, j])
            most[-1, j] = _larger(abs(gain / h - mean_a) - 0.5 * change, most[-1, j])
