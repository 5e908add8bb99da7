"""Joint limits, where a joint posture enters: starts, goals, states of the simulator."""

import numpy as np

from minidual.robot.pair import Array, Robot

ROUNDING_RAD = 1e-6
"""A posture this far beyond a limit is on it: float32 rounds joint positions by up to 1.2e-7."""


def outside_limits(q: Array, robot: Robot) -> np.ndarray:
    """Return which joints of q (n,) lie outside their limits by more than rounding; NaN does."""
    above_lower = q >= robot.q_lower - ROUNDING_RAD
    below_upper = q <= robot.q_upper + ROUNDING_RAD
    return ~(above_lower & below_upper)


def clipped(q: Array, robot: Robot) -> Array:
    """Return q (n,) with each joint on its nearest limit if it is outside."""
    return np.clip(q, robot.q_lower, robot.q_upper)


def joint_text(q_rad: float) -> str:
    """Return a joint position with enough digits to tell it from a limit that it exceeds."""
    return f"{q_rad:.9g}"
