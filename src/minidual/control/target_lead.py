"""Anticipate streamed targets: interpolate them, and feed their velocity forward.

    a = clip(w^2 e sqrt(s (2 - s)) + 2 w (v_target - v), +-a_max),  s = min(1, d / |e|)

with e, w and d as in `joint_control`. The reference lags a steady motion by the interpolation alone,
one period of the targets. Import late: it imports numba.
"""

import math

import numpy as np
from numba.core import types

from minidual.control.joint_control import reference_bounds
from minidual.robot.compiled import ROWS, VECTOR, kernel
from minidual.robot.pair import Array, Robot

BANDWIDTH_RAD_S = 60.0
"""Of the reference behind an interpolated target."""
SMOOTHING_S = 0.012
"""Time constant of the velocity's filter: a late sample is no jump."""

_BRAKE_SHARE = 0.9
"""Of the largest acceleration, for braking before a limit; the rest serves to track the curve."""


@kernel(types.void(VECTOR, VECTOR, ROWS, ROWS, types.float64, types.float64))
def track_target(
    target: Array,
    velocity: Array,
    state: Array,
    bounds: Array,
    w: float,
    dt: float,
) -> None:
    """Advance `state` (3, n) in place, q, v, a, towards a target (n,) that moves at a velocity (n,).

    bounds (5, n): see `kernels.follow_target`.
    """
    q = state[0]
    v = state[1]
    for j in range(len(target)):
        a_max = bounds[0, j]
        v_max = bounds[1, j]
        near = bounds[2, j]
        e = min(max(target[j], bounds[3, j]), bounds[4, j]) - q[j]
        s = near / max(abs(e), near)
        a = w * w * e * math.sqrt(s * (2.0 - s)) + 2.0 * w * (velocity[j] - v[j])
        a = min(max(a, -a_max), a_max)
        v_after = min(max(v[j] + dt * a, -v_max), v_max)
        # No faster than a joint can stop before its limit.
        brake = _BRAKE_SHARE * a_max
        to_upper = math.sqrt(2.0 * brake * max(bounds[4, j] - q[j], 0.0))
        to_lower = math.sqrt(2.0 * brake * max(q[j] - bounds[3, j], 0.0))
        v_after = min(v_after, max(to_upper, v[j] - dt * a_max))
        v_after = max(v_after, min(-to_lower, v[j] + dt * a_max))
        state[2, j] = (v_after - v[j]) / dt  # recomputed: the speed bound may have cut it
        q[j] = q[j] + dt * v_after
        v[j] = v_after


class AnticipatingFilter:
    """A reference (n,) that follows streamed targets with their velocity fed forward.

    It stands in for `joint_control.ReferenceFilter`.

    Args:
        dt_s: Control period.
        period_s: Of the targets.
        robot: The arms.

    Attributes:
        feeds: Whether the velocity is fed forward; not while the arms are being stopped.
    """

    def __init__(self, dt_s: float, period_s: float, robot: Robot) -> None:
        self._dt_s = dt_s
        self._steps = max(1, round(period_s / dt_s))
        self._bounds = reference_bounds(robot, BANDWIDTH_RAD_S)
        self._v_max = self._bounds[1].copy()
        self.feeds = False
        self._state = np.zeros((3, robot.dof))
        self._end = np.zeros(robot.dof)
        self._now = np.zeros(robot.dof)
        self._slope = np.zeros(robot.dof)
        self._velocity = np.zeros(robot.dof)
        self._left = 0

    def limit_speed(self, share: float) -> None:
        """Follow targets at most at this share of full speed, or at the present speed if it is more."""
        self._bounds[1] = np.maximum(share * self._v_max, np.abs(self._state[1]))

    def reset(self, q: Array, v: Array | None = None, joints: slice = slice(None)) -> None:
        """Start some joints from posture q (n,) [rad], by default all, at velocity v (n,) or at rest."""
        self._state[0, joints] = q[joints]
        self._state[1, joints] = 0.0 if v is None else v[joints]
        self._state[2, joints] = 0.0
        self._bounds[1] = np.maximum(self._bounds[1], np.abs(self._state[1]))
        self._end[joints] = q[joints]
        self._now[joints] = q[joints]
        self._slope[joints] = 0.0
        self._velocity[joints] = 0.0

    def step(self, target: Array) -> tuple[Array, Array, Array]:
        """Advance towards a streamed target (n,); return new (q_ref, v_ref, a_ref)."""
        self._interpolate(target)
        track_target(
            self._now,
            self._velocity,
            self._state,
            self._bounds,
            BANDWIDTH_RAD_S,
            self._dt_s,
        )
        q, v, a = self._state.copy()
        return q, v, a

    def _interpolate(self, target: Array) -> None:
        if not np.array_equal(target, self._end):
            self._end = np.array(target, dtype=float)
            self._slope = (self._end - self._now) / (self._steps * self._dt_s)
            self._left = self._steps
        velocity = np.zeros_like(self._slope)
        if self._left:
            self._left -= 1
            self._now = self._end - self._left * self._dt_s * self._slope
            if self.feeds:
                velocity = np.clip(self._slope, -self._v_max, self._v_max)
        share = min(1.0, self._dt_s / SMOOTHING_S)
        self._velocity = self._velocity + share * (velocity - self._velocity)
