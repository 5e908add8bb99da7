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
from numpy import absolute, divide, maximum, minimum, multiply, sqrt, subtract

from minidual.robot.constants import A_MAX, DOF, Q_LOWER, Q_UPPER, V_MAX, Array

_BRAKE_SHARE = 0.9
"""Share of the acceleration bound that the braking curve plans with; the rest follows the curve closely."""


class ReferenceFilter:
    """Second-order tracking of joint targets.

    Args:
        dt_s: Step of the control loop.
        bandwidth_rad_s: w; the reference lags a slowly moving target by 2 / w, a fast one by more.
        acceleration_scale: Fraction of the joints' acceleration limits that may be asked for.
    """

    def __init__(
        self, dt_s: float, *, bandwidth_rad_s: float = 30.0, acceleration_scale: float = 0.8
    ) -> None:
        w, dt = bandwidth_rad_s, dt_s
        self._a_max = acceleration_scale * A_MAX
        self._v_max = 0.95 * V_MAX
        self._a_min, self._v_min = -self._a_max, -self._v_max
        self._near = 4.0 * _BRAKE_SHARE * self._a_max / w**2
        # One block of rows, so that each of three sums over them is one product: the bent error, v, a, q, v afterwards.
        rows = np.zeros((5, DOF))
        self._bent, self._v, self._a, self._q, self._v_after = rows
        self._pull, self._push, self._motion = rows[0:2], rows[1:3], rows[1:5]
        self._spring = np.array([w**2, -2.0 * w])
        self._advance = np.array([1.0, dt])
        self._integrate = np.array([[0.0, 0.0, 1.0, dt], [-1.0 / dt, 0.0, 0.0, 1.0 / dt]])  # of q and a
        self._error, self._far = np.zeros((2, DOF))
        self._two = np.full(DOF, 2.0)
        self._asked, self._goal = b"", np.zeros(DOF)
        self.q, self.v, self.a = np.zeros((3, DOF))

    def reset(self, q: Array, v: Array | None = None, a: Array | None = None) -> None:
        """Start from posture q (14,) [rad] at velocity v and acceleration a (zero by default)."""
        self.q = np.array(q, dtype=float)
        self.v = np.zeros(DOF) if v is None else np.array(v, dtype=float)
        self.a = np.zeros(DOF) if a is None else np.array(a, dtype=float)

    def follow(self, q: Array, v: Array, a: Array) -> None:
        """Take over the state (each (14,)) of a reference that is already smooth, to go on from there.

        The acceleration is kept for readers only, as it was given: no step starts from it.
        """
        self.q, self.v, self.a = q.copy(), v.copy(), a

    def step(self, target: Array) -> tuple[Array, Array, Array]:
        """Advance one step towards target (14,) [rad]; return (q_ref, v_ref, a_ref).

        With s = min(1, d / |e|) both pieces of v_want are w/2 e sqrt(s (2 - s)), so that
        a = w^2 e sqrt(s (2 - s)) - 2 w v. Buffers are reused: the arrays that ufuncs would return cost more than
        their sums.
        """
        error, far, bent = self._error, self._far, self._bent
        asked = target.tobytes()
        if asked != self._asked:  # a target stands for many steps
            self._asked, self._goal = asked, maximum(minimum(target, Q_UPPER), Q_LOWER)
        subtract(self._goal, self.q, error)
        absolute(error, far)
        maximum(far, self._near, far)
        divide(self._near, far, bent)  # s
        subtract(self._two, bent, far)
        multiply(bent, far, bent)
        sqrt(bent, bent)
        multiply(bent, error, bent)
        self._v[:], self._q[:] = self.v, self.q
        a = self._spring.dot(self._pull)
        minimum(a, self._a_max, a)
        maximum(a, self._a_min, self._a)
        v = self._advance.dot(self._push)
        minimum(v, self._v_max, v)
        maximum(v, self._v_min, v)
        self._v_after[:] = v
        moved = self._integrate.dot(self._motion)
        self.q, self.v, self.a = moved[0], v, moved[1]  # a anew: the bound on the speed may have cut it
        return self.q, v, self.a
