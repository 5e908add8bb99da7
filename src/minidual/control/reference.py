"""Turn joint targets that arrive at 50 to 100 Hz into references at 1 kHz that the arms can follow.

    a = clip( 2 w (v_want(e) - v_ref), +- a_max ),  e = target - q_ref
    v_want(e) = w e / 2                          near the target
                sign(e) sqrt(2 b (|e| - d / 2))  further than d = 4 b / w^2, so that braking with b < a_max suffices

Near the target this is the critically damped filter w^2 e - 2 w v_ref; far from it the speed follows the braking
curve, without which a bounded acceleration would overshoot a large jump (by 0.2 rad for 1 rad) and with it the
joint limits. Both pieces meet with the same value and slope.

Acceleration and velocity are bounded and the targets are never differentiated, so a jump between two action
chunks asks for no more than a_max. Recording and deployment use this one filter with these same numbers;
otherwise a policy would be trained on one plant and run on another.
"""

from __future__ import annotations

import numpy as np

from minidual.control.kernels import follow_target
from minidual.robot.pair import Array, Robot

_BRAKE_SHARE = 0.9
"""Share of the acceleration bound that the braking curve plans with; the rest follows the curve closely."""


class ReferenceFilter:
    """Second-order tracking of joint targets.

    Args:
        dt_s: Step of the control loop.
        robot: The two arms.
        bandwidth_rad_s: w; the reference lags a slowly moving target by 2 / w, a fast one by more.
        acceleration_scale: Fraction of the joints' acceleration limits that may be asked for.
    """

    def __init__(
        self, dt_s: float, robot: Robot, *, bandwidth_rad_s: float = 30.0, acceleration_scale: float = 0.8
    ) -> None:
        self._w, self._dt = bandwidth_rad_s, dt_s
        a_max = acceleration_scale * robot.a_max
        near = 4.0 * _BRAKE_SHARE * a_max / bandwidth_rad_s**2
        self._bounds = np.array([a_max, 0.95 * robot.v_max, near, robot.q_lower, robot.q_upper])
        self._target = np.zeros(robot.dof)
        self.q, self.v, self.a = np.zeros((3, robot.dof))

    def reset(self, q: Array, v: Array | None = None, a: Array | None = None) -> None:
        """Start from posture q (n,) [rad] at velocity v and acceleration a (zero by default)."""
        self.q = np.array(q, dtype=float)
        self.v = np.zeros_like(self.q) if v is None else np.array(v, dtype=float)
        self.a = np.zeros_like(self.q) if a is None else np.array(a, dtype=float)

    def follow(self, q: Array, v: Array, a: Array) -> None:
        """Take over the state (each (n,)) of a reference that is already smooth, to go on from there.

        The acceleration is kept for readers only, as it was given: no step starts from it.
        """
        self.q, self.v, self.a = q.copy(), v.copy(), a

    def step(self, target: Array) -> tuple[Array, Array, Array]:
        """Advance one step towards target (n,) [rad]; return (q_ref, v_ref, a_ref).

        With s = min(1, d / |e|) both pieces of v_want are w/2 e sqrt(s (2 - s)), so that
        a = w^2 e sqrt(s (2 - s)) - 2 w v. The arrays returned are new ones.
        """
        self._target[:] = target
        after = np.empty((3, len(self._target)))
        follow_target(self._target, self.q, self.v, self._bounds, self._w, self._dt, after)
        self.q, self.v, self.a = after
        return self.q, self.v, self.a
