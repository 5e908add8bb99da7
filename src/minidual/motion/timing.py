"""Time parametrization within velocity, acceleration, jerk and torque limits, at 1 kHz.

The fastest profile (`minidual.motion.speed_profile`) is slowed down as a whole until its samples
keep every limit. Averaging s(t) over a window bounds jerk; k times slower means 1/k^3 of it.
"""

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numba import types
from pydantic import Field

from minidual.collision.errors import TimingError
from minidual.config.base import StrictModel
from minidual.config.planning import MotionLimits
from minidual.motion.speed_profile import (
    DT_S,
    Curve,
    PathSamples,
    fastest_profile,
    sample_parameters,
)
from minidual.robot.compiled import ROWS, VECTOR, floats, kernel
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Indices, Robot
from minidual.robot.trajectory import Trajectory

_SLOWDOWNS_MAX = 12
_TORQUE_EVERY = 8


class PathLimits(StrictModel):
    """Limits along a path in space and of each coordinate; one radian counts as 0.2 m."""

    speed_m_per_s: float = Field(default=0.3, gt=0.0)
    acceleration_m_per_s2: float = Field(default=1.0, gt=0.0)


class TimedPath(NamedTuple):
    """A trajectory along a curve.

    Attributes:
        trajectory: Samples at 1 kHz.
        s: Curve parameter of each sample (n,).
    """

    trajectory: Trajectory
    s: Array


class SpeedProfile(NamedTuple):
    """Path speed on a grid.

    Attributes:
        s: Path parameter (n,).
        speeds: ds/dt (n,), zero at both ends.
    """

    s: Array
    speeds: Array


class ColumnLimits(NamedTuple):
    """Limits of the columns of a curve that count.

    Attributes:
        columns: Their indices (c,).
        v_max: (c,) [unit/s].
        a_max: (c,) [unit/s^2].
    """

    columns: Indices
    v_max: Array
    a_max: Array


class _JointMotion(NamedTuple):
    """Samples of the joints.

    Attributes:
        v, a: (n, dof) [rad/s], [rad/s^2].
        most: Largest |v|, |a| and change of a between samples (3, dof).
    """

    v: Array
    a: Array
    most: Array


def column_limits(
    path: Curve,
    group: str,
    limits: MotionLimits,
    robot: Robot,
    along: PathLimits | None,
) -> ColumnLimits:
    """Return the limits of the group's joints and, if `along` is given, of the columns after them."""
    joints = np.arange(robot.dof)[robot.groups[group]]
    v_max = limits.velocity_scale * robot.v_max
    a_max = limits.acceleration_scale * robot.a_max
    if along is None:
        return ColumnLimits(joints, v_max[joints], a_max[joints])
    others = np.arange(robot.dof, path.at(path.knots[:1]).shape[1])
    return ColumnLimits(
        columns=np.append(joints, others),
        v_max=np.append(v_max[joints], np.full(len(others), along.speed_m_per_s)),
        a_max=np.append(a_max[joints], np.full(len(others), along.acceleration_m_per_s2)),
    )


def time_path(
    path: Curve,
    group: str,
    limits: MotionLimits,
    kinematics: Kinematics,
    along: PathLimits | None = None,
) -> TimedPath:
    """Return the trajectory of a curve, whose first columns are all joints.

    `along` limits the columns after the joints.

    Raises:
        TimingError: The limits cannot be kept.
    """
    bounds = column_limits(path, group, limits, kinematics.robot, along)
    s, speeds = fastest_profile(path, bounds.columns, bounds.v_max, bounds.a_max)
    return slowed_down(path, SpeedProfile(s, speeds), group, limits, kinematics)


def slowed_down(
    path: Curve,
    profile: SpeedProfile,
    group: str,
    limits: MotionLimits,
    kinematics: Kinematics,
    unlimited: Collection[str] = (),
) -> TimedPath:
    """Return the samples of a profile, slowed down as a whole until they keep the limits.

    `unlimited` names limits that do not count: "jerk", "torque_rate".

    Raises:
        TimingError: Slowing down does not suffice.
    """
    robot = kinematics.robot
    speeds = profile.speeds
    factor = 1.0
    for _ in range(_SLOWDOWNS_MAX):
        samples = sample_parameters(profile.s, speeds, limits.smoothing_s)
        motion = _joint_motion(path, samples, robot)
        factor = _slowdown(motion, limits, robot, unlimited)
        if not factor > 1.0 + 1e-9:
            q = path.at(samples.s)[:, : robot.dof]
            use = kinematics.torque_use(q, motion.v, motion.a, DT_S, _TORQUE_EVERY)
            uses = [use.torque] if "torque_rate" in unlimited else [use.torque, use.rate]
            ratio = np.max(uses) / limits.torque_scale
            # Gravity torque does not shrink with speed, so the steps are small.
            factor = 1.02 + 0.25 * np.minimum(1.0, ratio - 1.0)
            if not ratio > 1.0:
                trajectory = Trajectory(samples.times, q, motion.v, motion.a, group)
                return TimedPath(trajectory, samples.s)
        speeds = speeds / (factor * 1.001)
    raise TimingError(
        f"the path still needs to be {factor:.3f} times slower after {_SLOWDOWNS_MAX} slow-downs",
    )


def _joint_motion(path: Curve, samples: PathSamples, robot: Robot) -> _JointMotion:
    first = floats(path.at(samples.s, 1))
    second = floats(path.at(samples.s, 2))
    return _JointMotion(*_motion(first, second, samples.speed, samples.acceleration, robot.dof))


def _slowdown(
    motion: _JointMotion,
    limits: MotionLimits,
    robot: Robot,
    unlimited: Collection[str],
) -> float:
    """Return how many times slower the motion must be to keep velocity, acceleration and jerk."""
    allowed = np.stack(
        [
            limits.velocity_scale * robot.v_max,
            limits.acceleration_scale * robot.a_max,
            limits.jerk_scale * DT_S * robot.jerk_max,
        ],
    )
    velocity, acceleration, jerk = np.max(motion.most / allowed, axis=1).tolist()
    slowdown = max(velocity, math.sqrt(acceleration))
    if "jerk" in unlimited:
        return slowdown
    return max(slowdown, math.cbrt(jerk))


@kernel(types.UniTuple(ROWS, 3)(ROWS, ROWS, VECTOR, VECTOR, types.intp), heap=True)
def _motion(
    first: Array,
    second: Array,
    speed: Array,
    acceleration: Array,
    dof: int,
) -> tuple[Array, Array, Array]:
    """Return the fields of `_JointMotion`.

    Path derivatives are (n, d >= dof), path speed and acceleration (n,). NaN stays in v and a;
    `Trajectory` refuses it.
    """
    v = np.empty((len(speed), dof))
    a = np.empty((len(speed), dof))
    most = np.zeros((3, dof))
    for i in range(len(speed)):
        for j in range(dof):
            v[i, j] = first[i, j] * speed[i]
            a[i, j] = second[i, j] * (speed[i] * speed[i]) + first[i, j] * acceleration[i]
            before = a[i - 1, j] if i else 0.0
            most[0, j] = max(most[0, j], abs(v[i, j]))
            most[1, j] = max(most[1, j], abs(a[i, j]))
            most[2, j] = max(most[2, j], abs(a[i, j] - before))
    most[2] = np.maximum(most[2], np.abs(a[-1]))  # it rests before and after
    return v, a, most


def resting(q: Array, duration_s: float, group: str) -> Trajectory:
    """Return the trajectory that stays at q (n,)."""
    still = np.zeros((2, len(q)))
    return Trajectory(np.array([0.0, duration_s]), np.array([q, q]), still, still.copy(), group)
