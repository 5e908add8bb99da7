"""Does a timed trajectory stay inside the robot's limits? Measured on a finer grid than it was made on.

Position, velocity and acceleration are looked at every half millisecond (toppra's grid has about a hundred points
a path, ten to twenty times fewer), torque every millisecond. The acceleration of a trajectory is linear between its
samples, so its jerk is constant there and the differences of the samples give it exactly. What a trajectory says about
its velocity and acceleration counts only because both are held to what its positions and velocities do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minidual.proof.dynamics import torques
from minidual.proof.extremes import (
    ACCELERATION,
    CHANGE,
    JUMP,
    OFF_ACCELERATION,
    OFF_VELOCITY,
    Q_MAX,
    Q_MIN,
    SPEED,
    extremes,
    largest,
)
from minidual.robot.constants import A_MAX, JERK_MAX, JOINT_NAMES, Q_LOWER, Q_UPPER, TAU_MAX, V_MAX, Array
from minidual.robot.trajectory import Trajectory

_ROUNDING = 1e-9
_REST_RAD_S = 1e-6
_MISFIT = 0.05
"""By what part of the acceleration limit samples may contradict each other, beside what the acceleration changes by.
The most on the plans of the 300 stored queries of seed 20261 is 0.016."""


@dataclass(frozen=True)
class LimitUse:
    """How much of the robot's limits a trajectory uses.

    velocity_ratio, acceleration_ratio, jerk_ratio, torque_ratio: Largest fraction of a limit, of any joint.
    limit_margin_rad: Smallest distance of a joint from its position limit.
    """

    velocity_ratio: float
    acceleration_ratio: float
    jerk_ratio: float
    torque_ratio: float
    limit_margin_rad: float


def limit_use(trajectory: Trajectory) -> tuple[LimitUse, str]:
    """Return what the trajectory uses, and the first broken limit ("" if none) with joint and numbers."""
    h = trajectory.dt_s
    q, v, a = trajectory.q, trajectory.v, trajectory.a
    found = extremes(q, v, a, h)
    worst = {
        "velocity": found[SPEED] / V_MAX,
        "acceleration": found[ACCELERATION] / A_MAX,
        "jerk": found[CHANGE] / h / JERK_MAX,
        "torque": largest(torques(q, v, a)) / TAU_MAX,
    }
    margin = np.minimum(found[Q_MIN] - Q_LOWER, Q_UPPER - found[Q_MAX])
    use = LimitUse(
        *(float(worst[what].max()) for what in ("velocity", "acceleration", "jerk", "torque")),
        limit_margin_rad=float(margin.min()),
    )
    if not margin.min() >= -_ROUNDING:
        joint = int(np.argmin(margin))
        return use, f"{JOINT_NAMES[joint]} leaves its position limit by {-margin.min():.4f} rad"
    for what, ratios in worst.items():
        joint = int(np.argmax(ratios))
        if not ratios[joint] <= 1.0 + _ROUNDING:
            return use, f"{JOINT_NAMES[joint]} needs {ratios[joint]:.3f} of its {what} limit"
    at_ends = float(np.abs(trajectory.v[[0, -1]]).max())
    if not at_ends <= _REST_RAD_S:
        return use, f"the arms still move at {at_ends:.4f} rad/s at an end"
    jump = float(found[JUMP].max()) / h
    if not jump <= float(V_MAX.max()) * (1.0 + 1e-6):
        return use, f"positions jump: {jump:.2f} rad/s between two samples"
    for what, of, row, misfit in (
        ("velocity", "positions", OFF_VELOCITY, _velocity_misfit),
        ("acceleration", "velocity", OFF_ACCELERATION, _acceleration_misfit),
    ):
        if (found[row] / A_MAX).max() <= _MISFIT:
            continue
        off = misfit(trajectory) / A_MAX  # again, sample by sample
        sample, joint = np.unravel_index(int(np.argmax(off)), off.shape)
        return use, (
            f"the {what} of {JOINT_NAMES[joint]} is not that of its {of}: {off[sample, joint] * A_MAX[joint]:.2f} "
            f"rad/s^2 off after {trajectory.times[sample]:.3f} s"
        )
    return use, ""


def _acceleration_misfit(trajectory: Trajectory) -> Array:
    """Return (n - 1, 14) [rad/s^2]: how far the accelerations are from the change of velocity between two samples.

    Half of what they differ by is taken off, because an acceleration that jumps may do so anywhere in between.
    """
    v, a = trajectory.v, trajectory.a
    return np.abs(np.diff(v, axis=0) / trajectory.dt_s - 0.5 * (a[1:] + a[:-1])) - 0.5 * _change(a)


def _velocity_misfit(trajectory: Trajectory) -> Array:
    """Return (n - 1, 14) [rad/s^2]: what the cubic between two samples accelerates more than the samples say.

    A cubic whose mean speed is not the mean of the speeds at its ends speeds up and slows down by six times the
    difference over the step; an acceleration that changes explains as much as it changes by.
    """
    v, h = trajectory.v, trajectory.dt_s
    off = np.diff(trajectory.q, axis=0) / h - 0.5 * (v[1:] + v[:-1])
    return np.abs(6.0 * off / h) - _change(trajectory.a)


def _change(a: Array) -> Array:
    return np.abs(np.diff(a, axis=0))
