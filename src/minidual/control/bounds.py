"""The supervisor's bounds: the arms' limits, tightened by the configuration."""

import numpy as np
from numba.core import types

from minidual.config.control import SupervisorConfig
from minidual.robot.compiled import ROWS, VECTOR, VIEW, kernel
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot

QUANTITIES: tuple[str, ...] = (
    "position",
    "velocity",
    "torque",
    "torque_step",
    "acceleration",
    "acceleration_step",
)
"""Quantities compared each tick, per joint; a step is a difference between ticks."""

POSITION_TOLERANCE_RAD = 1e-3  # targets may lie on the bound; tracking is imperfect
TORQUE_TOLERANCE = 1e-6  # relative excess accepted as rounding
SATURATED = 0.999
"""Share of the torque limit that counts as saturated; controllers clip at 1."""
_WIDTH_M = 0.1
"""Lateral extent of a link or hand."""


# One array an argument: numba unpacks a structure at a cost of a microsecond a call.
@kernel(types.float64(VIEW, VIEW, VIEW, VECTOR, VIEW, types.boolean, ROWS, ROWS, ROWS))
def excess(
    q: Array,
    v: Array,
    tau: Array,
    applied: Array,
    a_ref: Array,
    follows: bool,
    centre: Array,
    scale: Array,
    rows: Array,
) -> float:
    """Return the largest |x - centre| scale of QUANTITIES; NaN stays.

    Args:
        q, v, tau: (n,) measured, and requested torque.
        applied: Torque (n,) of the last tick, from which the torque's step counts.
        a_ref: Reference acceleration (n,).
        follows: Whether the last tick had a reference acceleration; else its step is 0.
        centre, scale: (6, n), see `TickBounds`.
        rows: (6, n), filled with QUANTITIES.
    """
    largest = 0.0
    for j in range(len(applied)):
        rows[0, j] = q[j]
        rows[1, j] = v[j]
        rows[2, j] = tau[j]
        rows[3, j] = tau[j] - applied[j]
        rows[5, j] = a_ref[j] - rows[4, j] if follows else 0.0
        rows[4, j] = a_ref[j]
    for i in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            ratio = abs(rows[i, j] - centre[i, j]) * scale[i, j]
            if ratio > largest or ratio != ratio:
                largest = ratio
    return largest


class TickBounds:
    """Bounds of QUANTITIES: `|x - centre| * scale > 1` needs a closer check.

    Attributes:
        centre, scale: (6, n).
        q_lower, q_upper: (n,) [rad], margins applied.
        tau_step, a_step: Largest change per tick.
    """

    def __init__(self, config: SupervisorConfig, dt_s: float, robot: Robot) -> None:
        self.q_lower = robot.q_lower + config.position_margin_rad
        self.q_upper = robot.q_upper - config.position_margin_rad
        self.v_max = config.velocity_scale * robot.v_max
        self.tau_max = config.torque_scale * robot.tau_max
        self.tau_step = config.torque_rate_scale * robot.tau_rate_max * dt_s
        self.a_max = config.acceleration_scale * robot.a_max
        self.a_step = robot.jerk_max * dt_s
        rounding = 1.0 + 1e-9
        half = np.stack(
            [
                0.5 * (self.q_upper - self.q_lower) + POSITION_TOLERANCE_RAD,
                self.v_max,
                SATURATED * self.tau_max,
                np.full(robot.dof, self.tau_step) * rounding,
                self.a_max * rounding,
                self.a_step * rounding,
            ],
        )
        self.centre = np.zeros_like(half)
        self.centre[0] = 0.5 * (self.q_lower + self.q_upper)
        self.scale = 1.0 / half


class Reach:
    """Bounds on the motion of arm points.

    Attributes:
        m: (n,) [m]; a turn dq of joint j moves no point by more than m[j] |dq|.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        model = kinematics.model
        robot = kinematics.robot
        chain: list[float] = []
        for arm, frame in enumerate(kinematics.tcp_ids):
            names = robot.joint_names[robot.joints_of(arm)]
            placements = [model.jointPlacements[model.getJointId(name)] for name in names]
            placements.append(model.frames[frame].placement)
            lengths = [float(np.abs(one.translation).sum()) for one in placements[1:]]
            chain += np.cumsum(lengths[::-1])[::-1].tolist()
        self.m = np.array(chain) + _WIDTH_M
        self._acceleration = float(self.m @ robot.a_max)

    def safe_time_s(self, v: Array, gap_m: float) -> float:
        """Return the time [s] in which a gap [m] cannot close.

        In time h a gap shrinks by at most h sum_j m[j] (|v_j| + a_j h), over both arms.
        """
        speed = float(self.m @ np.abs(v))
        root = np.sqrt(speed * speed + 4.0 * self._acceleration * max(0.0, gap_m))
        return float(root - speed) / (2.0 * self._acceleration)
