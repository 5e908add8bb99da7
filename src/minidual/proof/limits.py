"""Use of the robot's limits by a trajectory, between its samples too; torques every 4 ms."""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numba.core import types

from minidual.errors import UsageError
from minidual.robot import vectors
from minidual.robot.compiled import ROWS, floats, inlined, kernel
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot
from minidual.robot.trajectory import Trajectory

_ROUNDING = 1e-9
_REST_RAD_S = 1e-6
_TORQUE_S = 0.004
_MISFIT = 0.05  # share of the acceleration limit; plans of 300 stored queries reach 0.016


class LimitUse(NamedTuple):
    """Largest use of each limit.

    Attributes:
        velocity_ratio, acceleration_ratio, jerk_ratio, torque_ratio, torque_rate_ratio: Largest
            fraction of each limit.
        limit_margin_rad: Smallest distance to a position limit.
        broken: The first broken limit, or "".
    """

    velocity_ratio: float
    acceleration_ratio: float
    jerk_ratio: float
    torque_ratio: float
    torque_rate_ratio: float
    limit_margin_rad: float
    broken: str


class _Extremes(NamedTuple):
    """Maxima over a motion, by joint (dof,).

    Of the samples and of the cubics between them, whose control points contain the positions.

    Attributes:
        negative_position, position: Of -q and q [rad].
        speed: Of |v| [rad/s].
        acceleration: Of |a| [rad/s^2].
        acceleration_step: Change of a between two samples [rad/s^2].
        position_step: Change of q between two samples [rad].
        velocity_misfit: Difference of v from that of the positions [rad/s^2].
        acceleration_misfit: Difference of a from that of the velocities [rad/s^2].
    """

    negative_position: Array
    position: Array
    speed: Array
    acceleration: Array
    acceleration_step: Array
    position_step: Array
    velocity_misfit: Array
    acceleration_misfit: Array


def check_robot(robot: Robot, trajectory: Trajectory) -> None:
    """Raise UsageError for a trajectory of another robot."""
    joints_n = trajectory.q.shape[1]
    if joints_n != robot.dof:
        raise UsageError(
            f"the trajectory has {joints_n} joints, the arms {robot.name} have {robot.dof}",
        )


def limit_use(
    trajectory: Trajectory,
    kinematics: Kinematics,
    reported: Collection[str] = (),
) -> LimitUse:
    """Return how much of each limit a trajectory uses.

    `reported` names limits that may be exceeded: "jerk", "torque_rate".

    Raises:
        UsageError: A trajectory of another robot.
    """
    robot = kinematics.robot
    check_robot(robot, trajectory)
    dt = trajectory.dt_s
    extremes = _extremes_of(trajectory)
    # The arms rest before and after.
    end_steps = np.abs(trajectory.a[[0, -1]]).max(axis=0)
    acceleration_steps = np.maximum(extremes.acceleration_step, end_steps)
    torque_every = max(1, round(_TORQUE_S / dt))
    torque, torque_rate = kinematics.torque_use(
        trajectory.q,
        trajectory.v,
        trajectory.a,
        dt,
        torque_every,
    )
    ratios = {
        "velocity": extremes.speed / robot.v_max,
        "acceleration": extremes.acceleration / robot.a_max,
        "jerk": acceleration_steps / dt / robot.jerk_max,
        "torque": torque,
        "torque_rate": torque_rate,
    }
    below = -extremes.negative_position - robot.q_lower
    above = robot.q_upper - extremes.position
    margins = np.minimum(below, above)
    return LimitUse(
        velocity_ratio=float(ratios["velocity"].max()),
        acceleration_ratio=float(ratios["acceleration"].max()),
        jerk_ratio=float(ratios["jerk"].max()),
        torque_ratio=float(ratios["torque"].max()),
        torque_rate_ratio=float(ratios["torque_rate"].max()),
        limit_margin_rad=float(margins.min()),
        broken=(
            _broken_limit(robot, margins, ratios, reported)
            or _moving_end(trajectory)
            or _inconsistent(robot, extremes, dt)
        ),
    )


def _broken_limit(
    robot: Robot,
    margins: Array,
    ratios: dict[str, Array],
    reported: Collection[str],
) -> str:
    """Return the first limit that is exceeded, or ""; limits that are only reported do not count."""
    names = robot.joint_names
    if not margins.min() >= -_ROUNDING:
        joint = int(np.argmin(margins))
        return f"{names[joint]} leaves its position limit by {-margins.min():.4f} rad"
    for limit, ratio in ratios.items():
        joint = int(np.argmax(ratio))
        exceeded = not ratio[joint] <= 1.0 + _ROUNDING
        if exceeded and (limit not in reported or not np.isfinite(ratio[joint])):
            name = limit.replace("_", " ")
            return f"{names[joint]} needs {ratio[joint]:.3f} of its {name} limit"
    return ""


def _moving_end(trajectory: Trajectory) -> str:
    """Return that the arms move at an end, or ""."""
    end_speed = float(np.abs(trajectory.v[[0, -1]]).max())
    if not end_speed <= _REST_RAD_S:
        return f"the arms still move at {end_speed:.4f} rad/s at an end"
    return ""


def _inconsistent(robot: Robot, extremes: _Extremes, dt: float) -> str:
    """Return how positions, velocities and accelerations disagree, or ""."""
    step = extremes.position_step.max()
    if not step / dt <= float(robot.v_max.max()) * (1.0 + 1e-6):
        return f"positions jump: {step / dt:.2f} rad/s between two samples"
    misfits = (
        ("velocity", "positions", extremes.velocity_misfit),
        ("acceleration", "velocity", extremes.acceleration_misfit),
    )
    for derivative, integral, misfit in misfits:
        joint = int(np.argmax(misfit / robot.a_max))
        if not misfit[joint] <= _MISFIT * robot.a_max[joint]:
            name = robot.joint_names[joint]
            return (
                f"the {derivative} of {name} is not that of its {integral}:"
                f" {misfit[joint]:.2f} rad/s^2 off"
            )
    return ""


_larger = inlined(vectors.larger)


def _extremes_of(trajectory: Trajectory) -> _Extremes:
    table = np.empty((8, trajectory.q.shape[1]))
    q = floats(trajectory.q)
    v = floats(trajectory.v)
    a = floats(trajectory.a)
    _fill_extremes(q, v, a, trajectory.dt_s, table)
    return _Extremes(*table)


@kernel(types.void(ROWS, ROWS, ROWS, types.float64, ROWS))
def _fill_extremes(q: Array, v: Array, a: Array, h: float, table: Array) -> None:
    """Fill the rows (8, dof) of `_Extremes`.

    A misfit is less the change of a (for a itself, half of it): a may jump within the step. NaN
    propagates.
    """
    negative_position = table[0]
    position = table[1]
    speed = table[2]
    acceleration = table[3]
    acceleration_step = table[4]
    position_step = table[5]
    velocity_misfit = table[6]
    acceleration_misfit = table[-1]
    table[:] = -np.inf
    for i in range(len(q)):
        for j in range(q.shape[1]):
            negative_position[j] = _larger(-q[i, j], negative_position[j])
            position[j] = _larger(q[i, j], position[j])
            speed[j] = _larger(abs(v[i, j]), speed[j])
            acceleration[j] = _larger(abs(a[i, j]), acceleration[j])
        if i == 0:
            continue
        for j in range(q.shape[1]):
            rise = q[i, j] - q[i - 1, j]
            change = abs(a[i, j] - a[i - 1, j])
            mean_v = 0.5 * (v[i, j] + v[i - 1, j])
            mean_a = 0.5 * (a[i, j] + a[i - 1, j])
            gain = (v[i, j] - v[i - 1, j]) / h
            # The cubic's acceleration is gain - bend at one end, gain + bend at the other.
            bend = abs(6.0 * (rise / h - mean_v) / h)
            for near in (q[i - 1, j] + h * v[i - 1, j] / 3.0, q[i, j] - h * v[i, j] / 3.0):
                negative_position[j] = _larger(-near, negative_position[j])
                position[j] = _larger(near, position[j])
            # The speed is a parabola; its vertex may lie within the step.
            turn = v[i - 1, j] - (3.0 * rise / h - 2.0 * mean_v)
            vertex = turn / (2.0 * turn + h * gain)
            if 0.0 < vertex < 1.0:
                speed[j] = _larger(abs(v[i - 1, j] - vertex * turn), speed[j])
            acceleration[j] = _larger(abs(gain) + bend, acceleration[j])
            position_step[j] = _larger(abs(rise), position_step[j])
            acceleration_step[j] = _larger(change, acceleration_step[j])
            velocity_misfit[j] = _larger(bend - change, velocity_misfit[j])
            off = abs(gain - mean_a) - 0.5 * change
            acceleration_misfit[j] = _larger(off, acceleration_misfit[j])
