"""The bounds that the supervisor holds, as arrays that one comparison can use.

The joint limits stand in `minidual.robot.constants`. Source of all of them: Franka Control Interface documentation,
"Robot and interface specifications", Panda; the same numbers are the constants of libfranka's `rate_limiting.h`
(which subtracts 1e-3 and a reserve for three lost packets, of which a simulation has none).
"""

from __future__ import annotations

import numpy as np

from minidual.config.supervisor import SupervisorConfig
from minidual.robot.constants import A_MAX, DOF, JERK_MAX, Q_LOWER, Q_UPPER, TAU_MAX, TAU_RATE_MAX, V_MAX, Array

ROWS: tuple[str, ...] = ("position", "velocity", "torque", "torque_step", "acceleration", "acceleration_step")
"""What is compared each tick, one row of 14 values each; the two steps are differences between two ticks."""

POSITION_TOLERANCE_RAD = 1e-3
"""How far beyond its bound a joint may be: targets may lie on the bound, and tracking is not perfect."""
TORQUE_TOLERANCE = 1e-6
"""Relative excess over a torque limit that is rounding and not a request."""
SATURATED = 0.999
"""Share of the torque limit from which a motor counts as saturated: controllers clip at the limit itself."""

REACH_M: Array = np.array([1.24, 1.24, 0.92, 0.84, 0.40, 0.40, 0.28] * 2)
"""Upper bound of the distance between each joint's axis and any point of the arm beyond it [m]: the sum of the
Panda's link lengths (0.316, 0.0825, 0.384, 0.088, 0.107 m) up to the fingertips of an open hand, rounded up. If joint
j turns by dq, no point moves by more than REACH_M[j] |dq|."""


class TickBounds:
    """Centre and reciprocal half-width of every row: `|x - centre| * scale > 1` means "look closer".

    Attributes:
        centre: (6, 14).
        scale: (6, 14).
        q_lower, q_upper: (14,) [rad], margins applied.
        v_max: (14,) [rad/s].
        tau_max: (14,) [Nm].
        tau_step: Largest change of a torque in one tick [Nm].
        a_max: (14,) [rad/s^2].
        a_step: (14,) largest change of the reference's acceleration in one tick [rad/s^2].
    """

    def __init__(self, config: SupervisorConfig, dt_s: float) -> None:
        self.q_lower = Q_LOWER + config.position_margin_rad
        self.q_upper = Q_UPPER - config.position_margin_rad
        self.v_max = config.velocity_scale * V_MAX
        self.tau_max = config.torque_scale * TAU_MAX
        self.tau_step = config.torque_rate_scale * TAU_RATE_MAX * dt_s
        self.a_max = config.acceleration_scale * A_MAX
        self.a_step = JERK_MAX * dt_s
        half = np.stack(
            [
                0.5 * (self.q_upper - self.q_lower) + POSITION_TOLERANCE_RAD,
                self.v_max,
                SATURATED * self.tau_max,
                np.full(DOF, self.tau_step * (1.0 + 1e-9)),
                self.a_max * (1.0 + 1e-9),
                self.a_step * (1.0 + 1e-9),
            ]
        )
        self.centre = np.zeros_like(half)
        self.centre[0] = 0.5 * (self.q_lower + self.q_upper)
        self.scale = 1.0 / half

    def stopping_point(self, q: Array, v: Array) -> Array:
        """Return where each joint (14,) [rad] would come to rest if it braked as hard as it may from here."""
        return q + v * np.abs(v) / (2.0 * A_MAX)


_REACH_ACCELERATION = float(REACH_M @ A_MAX)


def safe_time_s(v: Array, gap_m: float) -> float:
    """Return for how long [s] two parts of the arms cannot close a gap [m] between them, at any posture.

    Joint speeds (14,) [rad/s] may grow by the acceleration limits meanwhile, and both arms may move towards each other:
    in a time h no gap shrinks by more than h sum_j REACH_M[j] (|v_j| + a_j h).
    """
    speed = float(REACH_M @ np.abs(v))
    root = np.sqrt(speed * speed + 4.0 * _REACH_ACCELERATION * max(0.0, gap_m))
    return float(root - speed) / (2.0 * _REACH_ACCELERATION)
