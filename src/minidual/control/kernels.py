"""Compiled parts of the control laws.

Import late: it imports numba.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numba.core import types

from minidual.robot.compiled import BLOCKS, ROWS, VECTOR, kernel
from minidual.robot.pair import Array

_REAL = types.float64
_VIEW = types.Array(_REAL, 1, "A")
_TURNED = types.float64[::1, :]
"""Pinocchio's matrices are column-major."""


@njit
def within(x: float, low: float, high: float) -> float:
    """Return x clipped; NaN stays NaN."""
    return high if x > high else low if x < low else x


@njit
def cross(a: Array, b: Array) -> Array:
    """Return a x b."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@njit
def turn(wanted: Array, actual: Array) -> Array:
    """Return log(wanted actual^T) [rad], below half a turn."""
    E = wanted @ actual.T
    axis = 0.5 * np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]])
    sine = math.sqrt(axis @ axis)
    angle = math.atan2(sine, 0.5 * (E[0, 0] + E[1, 1] + E[2, 2] - 1.0))
    return (angle / sine if sine > 1e-12 else 1.0) * axis


@njit
def hand_wrenches(force: Array, moment: Array, r_left: Array, r_right: Array, squeeze: Array) -> Array:
    """Return G^+ w + (I - G^+ G) [-squeeze; 0; squeeze; 0] as (2, 6) (docs/force-control.md)."""
    m, h = 0.5 * (r_left + r_right), 0.5 * (r_left - r_right)
    n = moment - cross(m, force) + 2.0 * cross(h, squeeze)
    share = 0.5 / (1.0 + h @ h) * (n + (h @ n) * h)
    press = cross(share, h) - squeeze
    f = np.empty((2, 6))
    f[0, :3], f[0, 3:] = 0.5 * force + press, share
    f[1, :3], f[1, 3:] = 0.5 * force - press, share
    return f


@kernel(
    types.void(
        *(VECTOR, VECTOR, _REAL, ROWS, VECTOR, BLOCKS),
        *(ROWS, _VIEW, ROWS, _VIEW, _VIEW, _REAL),
        *(ROWS, VECTOR, VECTOR, VECTOR, _TURNED, _TURNED, VECTOR, VECTOR, VECTOR),
    )
)
def impedance(
    K: Array,
    D: Array,
    mass: float,
    inertia: Array,
    axis: Array,
    R_tcps_object: Array,
    T: Array,
    twist: Array,
    T_d: Array,
    twist_d: Array,
    a_d: Array,
    squeeze_n: float,
    J: Array,
    a_hands: Array,
    p_left: Array,
    p_right: Array,
    R_left: Array,
    R_right: Array,
    v: Array,
    qdd: Array,
    push: Array,
) -> None:
    """Add the hands' accelerations to qdd (n,) and fill push (n,) with J^T f; see `object_impedance`.

    Raises:
        LinAlgError: A hand has lost a direction of motion.
    """
    p, R, R_d = T[:3, 3], T[:3, :3].copy(), T_d[:3, :3].copy()
    a, alpha, omega = a_d[:3], a_d[3:], twist_d[3:]
    force = K[:3] * (T_d[:3, 3] - p) + D[:3] * (twist_d[:3] - twist[:3]) + mass * a
    force[2] += 9.81 * mass
    I_w = R @ inertia @ R.T
    moment = I_w @ alpha.copy() + cross(omega, I_w @ omega.copy())
    f = hand_wrenches(force, moment, p_left - p, p_right - p, squeeze_n * (R @ axis))
    n = len(v) // 2
    for i, (p_hand, R_hand) in enumerate(((p_left, R_left), (p_right, R_right))):
        hand, arm = slice(6 * i, 6 * i + 6), slice(n * i, n * i + n)
        J_hand, r = J[hand, arm].copy(), p_hand - p
        # Half the rotational stiffness, on the object's orientation as this hand's grasp implies it.
        error = turn(R_d, np.ascontiguousarray(R_hand) @ R_tcps_object[i])
        f[i, 3:] += 0.5 * (K[3:] * error + D[3:] * (omega - J_hand[3:] @ v[arm]))
        push[arm] = J_hand.T @ f[i]
        # J^+ (a_hand - J qdd - Jdot v), so that only the null space keeps the posture's acceleration.
        lacking = -a_hands[hand]
        lacking[:3] += a + cross(alpha, r) + cross(omega, cross(omega, r))
        lacking[3:] += alpha
        if np.isfinite(lacking).all():
            qdd[arm] += J_hand.T @ np.linalg.solve(J_hand @ J_hand.T, lacking)
        else:  # solve refuses NaN, which the supervisor must see
            qdd[arm] = np.nan


@kernel(types.void(VECTOR, VECTOR, _REAL, _REAL, VECTOR))
def add_friction(tau: Array, v: Array, damping: float, dry: float, tau_max: Array) -> None:
    """Add d v + c tanh(v / v_s) to tau (n,) and clip; tanh, because near rest the sign of v is noise."""
    for j in range(len(tau)):
        tau[j] += damping * v[j] + (dry * math.tanh(v[j] / 0.02) if dry != 0.0 else 0.0)
        tau[j] = within(tau[j], -tau_max[j], tau_max[j])


@kernel(types.void(VECTOR, VECTOR, VECTOR, ROWS, _REAL, _REAL, ROWS))
def follow_target(target: Array, q: Array, v: Array, bounds: Array, w: float, dt: float, after: Array) -> None:
    """Fill `after` (3, n) with the next q, v, a; see `reference`.

    bounds (5, n): a_max, v_max, d, lower, upper.
    """
    for j in range(len(target)):
        a_max, v_max, near = bounds[0, j], bounds[1, j], bounds[2, j]
        e = within(target[j], bounds[3, j], bounds[4, j]) - q[j]
        s = near / max(abs(e), near)
        a = within(w * w * e * math.sqrt(s * (2.0 - s)) - 2.0 * w * v[j], -a_max, a_max)
        v_after = within(v[j] + dt * a, -v_max, v_max)
        after[0, j] = q[j] + dt * v_after
        after[1, j] = v_after
        after[2, j] = (v_after - v[j]) / dt  # recomputed: the speed bound may have cut it
