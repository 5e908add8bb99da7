"""Turn joint targets that arrive at 50 to 100 Hz into references at 1 kHz that the arms can follow.

    a = clip( w^2 (target - q_ref) - 2 w v_ref, +- a_max )

A critically damped second-order filter with bounded acceleration and velocity: it never differentiates the
targets, so a jump between two action chunks asks for no more than a_max. Recording and deployment use this one
filter with these same numbers; otherwise a policy would be trained on one plant and run on another.
"""

from __future__ import annotations

import numpy as np

from minidual.robot.constants import A_MAX, Q_LOWER, Q_UPPER, V_MAX, Array


class ReferenceFilter:
    """Second-order tracking of joint targets.

    Args:
        dt_s: Step of the control loop.
        bandwidth_rad_s: w; the reference lags a moving target by 2 / w.
        acceleration_scale: Fraction of the joints' acceleration limits that may be asked for.
    """

    def __init__(self, dt_s: float, *, bandwidth_rad_s: float = 30.0, acceleration_scale: float = 0.8) -> None:
        self._dt = dt_s
        self._w = bandwidth_rad_s
        self._a_max = acceleration_scale * A_MAX
        self._v_max = 0.95 * V_MAX
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
        a = self._w**2 * (target - self.q) - 2.0 * self._w * self.v
        a = np.clip(a, -self._a_max, self._a_max)
        v = np.clip(self.v + self._dt * a, -self._v_max, self._v_max)
        self.a = (v - self.v) / self._dt
        self.q = self.q + self._dt * v
        self.v = v
        return self.q, self.v, self.a
