"""Bring the arms to rest without a jolt, and never ask a motor for a faster change of torque than it allows."""

from __future__ import annotations

import numpy as np

from minidual.robot.constants import A_MAX, TAU_RATE_MAX, Array


class TorqueRate:
    """Bounds the change of every motor's torque.

    Args:
        tau: Torques (14,) [Nm] that act now.
        dt_s: Control step.
        rate_nm_per_s: Bound; the drives' own limit by default.
    """

    def __init__(self, tau: Array, dt_s: float, *, rate_nm_per_s: float = TAU_RATE_MAX) -> None:
        self.tau = tau.copy()
        self._step = rate_nm_per_s * dt_s

    def limit(self, tau: Array) -> Array:
        """Return the torques (14,) nearest to tau that may follow the last ones."""
        change = tau - self.tau
        np.minimum(change, self._step, change)
        np.maximum(change, -self._step, change)
        self.tau = self.tau + change
        return self.tau


class SoftStop:
    """Joint reference that runs on from (q, v) and comes to rest with bounded deceleration.

    All joints share one profile, v(t) = v_0 (1 - s)^2 (1 + 2 s) with s = t / T, so two hands that hold one object
    keep to its motion at first. Its peak deceleration is 1.5 |v_0| / T.

    Args:
        q: Joint positions (14,) at the start.
        v: Joint velocities (14,).
        deceleration_share: Peak deceleration, as a share of the joints' limits.
        least_s: Shortest time to take.
    """

    def __init__(self, q: Array, v: Array, *, deceleration_share: float, least_s: float = 0.1) -> None:
        self._q, self._v = q.copy(), v.copy()
        self.duration_s = max(least_s, float(np.max(1.5 * np.abs(v) / (deceleration_share * A_MAX))))

    def at(self, t_s: float) -> tuple[Array, Array, Array]:
        """Return (q, v, a), each (14,), at time t after the start; at rest from `duration_s` on."""
        s = min(1.0, max(0.0, t_s / self.duration_s))
        speed = (1.0 - s) ** 2 * (1.0 + 2.0 * s)
        way = s - s**3 + 0.5 * s**4  # the integral of (1 - s)^2 (1 + 2 s) = 1 - 3 s^2 + 2 s^3
        slope = -6.0 * s + 6.0 * s * s
        return (
            self._q + self.duration_s * way * self._v,
            speed * self._v,
            slope / self.duration_s * self._v,
        )
