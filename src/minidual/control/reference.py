"""Turn joint targets arriving at 50 to 100 Hz into smooth references at 1 kHz.

    a = clip(2 w (v_want(e) - v_ref), +-a_max),  e = target - q_ref
    v_want(e) = w e / 2                         for |e| <= d = 4 b / w^2
                sign(e) sqrt(2 b (|e| - d / 2)) beyond, braking with b < a_max

w is the bandwidth. Recording and deployment must use the same numbers.
"""

import numpy as np

from minidual.control.kernels import follow_target
from minidual.robot.pair import Array, Robot

_BRAKE_SHARE = 0.9  # b / a_max; the rest serves to track the curve


class ReferenceFilter:
    """Second-order tracking of joint targets with lag 2 / w."""

    def __init__(self, dt_s: float, robot: Robot, *, bandwidth_rad_s: float = 30.0) -> None:
        self._w, self._dt = bandwidth_rad_s, dt_s
        a_max = 0.8 * robot.a_max
        near = 4.0 * _BRAKE_SHARE * a_max / bandwidth_rad_s**2
        self._v_max = self._v_allowed = 0.95 * robot.v_max
        self._bounds = np.array([a_max, self._v_max, near, robot.q_lower, robot.q_upper])
        self.q, self.v, self.a = np.zeros((3, robot.dof))
        self._slewing = False

    def limit_speed(self, share: float) -> None:
        """Follow targets at most at this share of full speed."""
        self._v_allowed, self._slewing = share * self._v_max, True

    def reset(self, q: Array, v: Array | None = None, a: Array | None = None) -> None:
        """Start from posture q (n,) [rad], by default at rest."""
        self.q = np.array(q, dtype=float)
        self.v = np.zeros_like(self.q) if v is None else np.array(v, dtype=float)
        self.a = np.zeros_like(self.q) if a is None else np.array(a, dtype=float)

    def step(self, target: Array) -> tuple[Array, Array, Array]:
        """Advance towards target (n,); return new (q_ref, v_ref, a_ref).

        With s = min(1, d/|e|), a = w^2 e sqrt(s (2 - s)) - 2 w v.
        """
        if self._slewing:  # no faster than the joints can brake
            v_max, brake = self._bounds[1], _BRAKE_SHARE * self._bounds[0] * self._dt
            v_max += np.clip(self._v_allowed - v_max, -brake, brake)
            self._slewing = bool((v_max != self._v_allowed).any())
        after = np.empty((3, len(target)))
        follow_target(target, self.q, self.v, self._bounds, self._w, self._dt, after)
        self.q, self.v, self.a = after
        return self.q, self.v, self.a
