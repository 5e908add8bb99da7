"""Check a timed trajectory against the robot's limits, midway between samples too; torque at every fourth sample."""

from dataclasses import dataclass

import numpy as np

from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.robot.trajectory import Trajectory, largest

_ROUNDING = 1e-9
_REST_RAD_S = 1e-6
_TORQUE_EVERY = 4
_BLOCK = 500  # samples at a time; longer blocks leave the processor's cache
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
    found = np.max([_extremes(trajectory, slice(k, k + _BLOCK + 1)) for k in range(0, n - 1, _BLOCK)], axis=0)
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


def _extremes(trajectory: Trajectory, rows: slice) -> Array:
    """Return (8, dof): maxima of -q, q, |v|, |a|, change of a, step of q, mismatch of v, mismatch of a [rad/s^2].

    A cubic whose mean speed differs from the mean end speed accelerates by six times the difference over the step. The
    acceleration's change (for a, half of it) is subtracted. NaN propagates.
    """
    h = trajectory.dt_s
    # (dof, n): row maxima are ten times faster than column maxima.
    q, v, a = (np.ascontiguousarray(x[rows].T) for x in (trajectory.q, trajectory.v, trajectory.a))
    rise, change = np.diff(q), np.abs(np.diff(a))
    mean_v, mean_a = 0.5 * (v[:, 1:] + v[:, :-1]), 0.5 * (a[:, 1:] + a[:, :-1])
    q_middle = 0.5 * (q[:, 1:] + q[:, :-1]) - 0.125 * h * np.diff(v)
    v_middle = 1.5 * rise / h - 0.5 * mean_v
    groups = (
        (-q, -q_middle),
        (q, q_middle),
        (np.abs(v), np.abs(v_middle)),
        (np.abs(a), np.abs(mean_a)),
        (change,),
        (np.abs(rise),),
        (np.abs(6.0 * (rise / h - mean_v) / h) - change,),
        (np.abs(np.diff(v) / h - mean_a) - 0.5 * change,),
    )
    return np.array([np.max([x.max(axis=1) for x in group], axis=0) for group in groups])
