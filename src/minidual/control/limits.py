"""The bounds that the supervisor holds, as arrays that one comparison can use.

The limits are the robot's (see `minidual.robot.arms` for their sources); the configuration may only tighten them.
"""

from __future__ import annotations

import numpy as np

from minidual.config.supervisor import SupervisorConfig
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot

ROWS: tuple[str, ...] = ("position", "velocity", "torque", "torque_step", "acceleration", "acceleration_step")
"""What is compared each tick, one value a joint; the two steps are differences between two ticks."""

POSITION_TOLERANCE_RAD = 1e-3
"""How far beyond its bound a joint may be: targets may lie on the bound, and tracking is not perfect."""
TORQUE_TOLERANCE = 1e-6
"""Relative excess over a torque limit that is rounding and not a request."""
SATURATED = 0.999
"""Share of the torque limit from which a motor counts as saturated: controllers clip at the limit itself."""
_WIDTH_M = 0.1
"""How far a link or a hand reaches sideways from the line through the joints."""


class TickBounds:
    """Centre and reciprocal half-width of every row: `|x - centre| * scale > 1` means "look closer".

    Attributes:
        centre: (6, n).
        scale: (6, n).
        q_lower, q_upper: (n,) [rad], margins applied.
        v_max: (n,) [rad/s].
        tau_max: (n,) [Nm].
        tau_step: Largest change of a torque in one tick [Nm].
        a_max: (n,) [rad/s^2].
        a_step: (n,) largest change of the reference's acceleration in one tick [rad/s^2].
    """

    def __init__(self, config: SupervisorConfig, dt_s: float, robot: Robot) -> None:
        self.q_lower = robot.q_lower + config.position_margin_rad
        self.q_upper = robot.q_upper - config.position_margin_rad
        self.v_max = config.velocity_scale * robot.v_max
        self.tau_max = config.torque_scale * robot.tau_max
        self.tau_step = config.torque_rate_scale * robot.arm.tau_rate_max * dt_s
        self.a_max = config.acceleration_scale * robot.a_max
        self.a_step = robot.jerk_max * dt_s
        self._a_brake = robot.a_max
        half = np.stack(
            [
                0.5 * (self.q_upper - self.q_lower) + POSITION_TOLERANCE_RAD,
                self.v_max,
                SATURATED * self.tau_max,
                np.full(robot.dof, self.tau_step * (1.0 + 1e-9)),
                self.a_max * (1.0 + 1e-9),
                self.a_step * (1.0 + 1e-9),
            ]
        )
        self.centre = np.zeros_like(half)
        self.centre[0] = 0.5 * (self.q_lower + self.q_upper)
        self.scale = 1.0 / half

    def stopping_point(self, q: Array, v: Array) -> Array:
        """Return where each joint (n,) [rad] would come to rest if it braked as hard as it may from here."""
        return q + v * np.abs(v) / (2.0 * self._a_brake)


class Reach:
    """How far any point of an arm can be from each joint's axis, and how fast two parts can therefore approach.

    Attributes:
        m: (n,) [m]; if joint j turns by dq, no point of the arm moves by more than m[j] |dq|. It is the length of the
            chain from the joint to the tool centre point, each step taken along the axes, and the width of a hand.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        model, robot = kinematics.model, kinematics.robot
        chain: list[float] = []
        for arm, frame in enumerate(kinematics.tcp_ids):
            tool = model.frames[frame]
            steps = [model.jointPlacements[model.getJointId(name)] for name in robot.joint_names[robot.joints_of(arm)]]
            lengths = [float(np.abs(step.translation).sum()) for step in (*steps[1:], tool.placement)]
            chain += np.cumsum(lengths[::-1])[::-1].tolist()
        self.m = np.array(chain) + _WIDTH_M
        self._acceleration = float(self.m @ robot.a_max)

    def safe_time_s(self, v: Array, gap_m: float) -> float:
        """Return for how long [s] two parts of the arms cannot close a gap [m] between them, at any posture.

        Joint speeds (n,) [rad/s] may grow by the acceleration limits meanwhile, and both arms may move towards each
        other: in a time h no gap shrinks by more than h sum_j m[j] (|v_j| + a_j h).
        """
        speed = float(self.m @ np.abs(v))
        root = np.sqrt(speed * speed + 4.0 * self._acceleration * max(0.0, gap_m))
        return float(root - speed) / (2.0 * self._acceleration)
