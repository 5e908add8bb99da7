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

from minidual.robot.constants import A_MAX, Q_LOWER, Q_UPPER, V_MAX, Array

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
        self._dt = dt_s
        self._w = bandwidth_rad_s
        self._a_max = acceleration_scale * A_MAX
        self._v_max = 0.95 * V_MAX
        self._brake = _BRAKE_SHARE * self._a_max
        self._near = 4.0 * self._brake / self._w**2
        self.q = np.zeros_like(A_MAX)
        self.v = np.zeros_like(A_MAX)
        self.a = np.zeros_like(A_MAX)

    def reset(self, q: Array, v: Array | None = None) -> None:
        """Start from posture q (14,) [rad] at velocity v (zero by default)."""
        self.q = np.array(q, dtype=float)
        self.v = np.zeros_like(self.q) if v is None else np.array(v, dtype=float)
        self.a = np.zeros_like(self.q)

    def step(self, target: Array) -> tuple[Array, Array, Array]:
        """Advance one step towards target (14,) [rad]; return (q_ref, v_ref, a_ref)."""
        target = np.clip(target, Q_LOWER, Q_UPPER)
        error = target - self.q
        far = np.maximum(np.abs(error), self._near)
        # |v_want| / |error| is w / 2 up to `near` and falls beyond it, so one factor serves both pieces.
        v_want = error * (np.sqrt(2.0 * self._brake * (far - 0.5 * self._near)) / far)
        a = np.clip(2.0 * self._w * (v_want - self.v), -self._a_max, self._a_max)
        v = np.clip(self.v + self._dt * a, -self._v_max, self._v_max)
        self.a = (v - self.v) / self._dt
        self.q = self.q + self._dt * v
        self.v = v
        return self.q, self.v, self.a
