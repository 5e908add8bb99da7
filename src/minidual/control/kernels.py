"""Compiled parts of the control laws.

Vectors of three are tuples, which numba keeps in registers: arrays cost the object impedance four times as much.
Import late: it imports numba.
"""

import math
from typing import Any

import numpy as np
from numba import njit
from numba.core import types

from minidual.robot import vectors
from minidual.robot.compiled import ROWS, VECTOR, VIEW, kernel
from minidual.robot.pair import Array

_REAL = types.float64
_TURNED = types.float64[::1, :]  # Pinocchio's matrices are column-major
POSE = types.Array(_REAL, 2, "A", readonly=True)
HANDS = types.Tuple([_TURNED, VECTOR, VECTOR, _TURNED, _TURNED, types.intp])

Vector = tuple[float, float, float]
Elements = Any
"""A vector of three, as a tuple or an array."""
Placed = tuple[Array, Array, Array, Array, Array, int]
"""See `Hands.views`."""
_shared = vectors.cross, vectors.plus, vectors.minus, vectors.times, vectors.inner, vectors.larger
_algebra: Any = map(njit, (*_shared, vectors.solve_gram, vectors.rotation_vector))
cross, plus, minus, times, inner, larger, solve_gram, rotation_vector = _algebra


@njit
def within(x: float, low: float, high: float) -> float:
    """Return x clipped; NaN stays NaN."""
    if x > high:
        return high
    if x < low:
        return low
    return x


@njit
def three(a: Elements, i: int) -> Vector:
    """Return a[i : i + 3]."""
    return a[i], a[i + 1], a[i + 2]


@njit
def apply(A: Array, x: Elements) -> Vector:
    """Return A x."""
    return inner(A[0], x), inner(A[1], x), inner(A[2], x)


@njit
def own_joints(arm: int, left_n: int, n: int) -> tuple[int, int]:
    """Return the first joint of an arm and the end of its joints, of n joints, `left_n` on the left."""
    if arm == 0:
        return 0, left_n
    return left_n, n


@njit
def add_product(y: Array, sign: float, A: Array, x: Array) -> None:
    """Add sign A x to y, term by term."""
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            y[i] += sign * A[i, j] * x[j]


@njit
def turn(wanted: Array, actual: Array) -> tuple[Vector, float]:
    """Return log(wanted actual^T) [rad] and its angle."""
    return rotation_vector(
        apply(actual, wanted[0]),
        apply(actual, wanted[1]),
        apply(actual, wanted[2]),
    )


@kernel(types.UniTuple(_REAL, 2)(POSE, POSE, VECTOR))
def apart(T: Array, T_other: Array, way: Array) -> tuple[float, float]:
    """Fill `way` (6,) with the motion from T_other to T, world axes; return its distance [m] and angle [rad]."""
    moved = minus(three(T[:, 3], 0), three(T_other[:, 3], 0))
    turned, angle = turn(T, T_other)
    way[:3] = moved
    way[3:] = turned
    return math.sqrt(inner(moved, moved)), angle


@kernel(types.UniTuple(_REAL, 2)(POSE, POSE, _REAL, ROWS))
def approach(T: Array, goal: Array, share: float, moved: Array) -> tuple[float, float]:
    """Fill `moved` (4, 4) with T moved by a share of the way to a goal; return that way's distance [m] and angle [rad]."""
    p = three(T[:, 3], 0)
    turned, angle = turn(goal, T)
    way = minus(three(goal[:, 3], 0), p)
    axis = times(share, turned)
    square = inner(axis, axis)
    size = math.sqrt(square)
    sine = 1.0
    cosine = 0.5
    if size > 1e-6:
        sine = math.sin(size) / size
        cosine = (1.0 - math.cos(size)) / square
    for k in range(3):  # Rodrigues
        across = cross(axis, three(T[:, k], 0))
        moved[:3, k] = plus(
            three(T[:, k], 0),
            plus(times(sine, across), times(cosine, cross(axis, across))),
        )
        moved[3, k] = T[3, k]
    moved[:3, 3] = plus(p, times(share, way))
    moved[3, 3] = T[3, 3]
    return math.sqrt(inner(way, way)), angle


@njit
def hand_motion(J: Array, p: Elements, v: Array, J_hand: Array) -> tuple[Vector, Vector]:
    """Fill J_hand (6, n), [linear; angular] at p, and return Jdot v (linear, angular).

    J (6, n) is of the points at the world's origin; each column turns with the joints before it.
    """
    V = omega = a = alpha = (0.0, 0.0, 0.0)
    for j in range(len(v)):
        linear = three(J[:, j], 0)
        angular = three(J[:, j], 3)
        V = plus(V, times(v[j], linear))
        omega = plus(omega, times(v[j], angular))
        a = plus(a, times(v[j], plus(cross(omega, linear), cross(V, angular))))
        alpha = plus(alpha, times(v[j], cross(omega, angular)))
        J_hand[:3, j] = plus(linear, cross(angular, p))
        J_hand[3:, j] = angular
    return plus(plus(a, cross(alpha, p)), cross(omega, plus(V, cross(omega, p)))), alpha


@njit
def least_norm(J: Array, y: Array, x: Array, L: Array) -> bool:
    """Add J^T (J J^T)^-1 y to x, J (6, n), and overwrite y and L (6, 6); return False if J lost a rank."""
    if not solve_gram(J, y, 0.0, L):
        return False
    for i in range(5, -1, -1):
        for k in range(J.shape[1]):
            x[k] += J[i, k] * y[i]
    return True


@kernel(types.void(HANDS, VECTOR, VECTOR, _REAL, ROWS), heap=True)
def hand_look(hands: Placed, v: Array, torque: Array, ahead_s: float, out: Array) -> None:
    """Fill `out` (2, 5): each hand's force |(J J^T + 1e-3)^-1 J torque| [N], speed [m/s], and place [m] in `ahead_s`."""
    J, p_left, p_right, _, _, left_n = hands
    y = np.empty(6)
    velocity = np.empty(3)
    for i, p in enumerate((three(p_left, 0), three(p_right, 0))):
        first, end = own_joints(i, left_n, len(v))
        own = slice(first, end)
        J_hand = np.empty((6, end - first))
        hand_motion(J[:, own], p, v[own], J_hand)
        y[:] = 0.0
        velocity[:] = 0.0
        add_product(y, 1.0, J_hand, torque[own])
        solve_gram(J_hand, y, 1e-3, np.empty((6, 6)))
        add_product(velocity, 1.0, J_hand[:3], v[own])
        out[i, 0] = math.sqrt(inner(y, y))
        out[i, 1] = math.sqrt(inner(velocity, velocity))
        out[i, 2:] = plus(p, times(ahead_s, velocity))


@kernel(types.UniTuple(_REAL, 3)(_REAL))
def minimum_jerk(s: float) -> tuple[float, float, float]:
    """Return the quintic rest-to-rest blend at s, clipped to 0..1, and its first two derivatives."""
    s = within(s, 0.0, 1.0)
    return (
        s**3 * (10.0 + s * (6.0 * s - 15.0)),
        30.0 * s**2 * (1.0 - s) ** 2,
        60.0 * s * (1.0 + s * (2.0 * s - 3.0)),
    )


# One array an argument: see `bounds.excess`.
@kernel(types.boolean(POSE, VIEW, VIEW, VIEW, ROWS, VECTOR, VECTOR))
def adopt(
    T: Array,
    twist: Array,
    acceleration: Array,
    most: Array,
    T_own: Array,
    twist_own: Array,
    a_own: Array,
) -> bool:
    """Copy a pose and its motion, if the pose is near the last one and the motion within bounds; else, or for NaN, return false.

    most (6,): difference of rotations' entries and of positions', speed, rate of turning, and their accelerations.
    """
    for i in range(3):
        for k in range(4):
            largest = most[1] if k == 3 else most[0]
            if not abs(T[i, k] - T_own[i, k]) <= largest:
                return False
    for i in range(4):
        x = three(twist if i < 2 else acceleration, 3 * (i % 2))
        if not inner(x, x) <= most[2 + i] ** 2:
            return False
    for k in range(4):
        T_own[:3, k] = three(T[:, k], 0)
    for k in range(6):
        twist_own[k] = twist[k]
        a_own[k] = acceleration[k]
    return True


# One array an argument: see `bounds.excess`.
@kernel(types.void(*[VIEW] * 5, _REAL, VECTOR))
def servo(q: Array, v: Array, q_ref: Array, v_ref: Array, a_ref: Array, w: float, a: Array) -> None:
    """Fill a (n,) with a_ref + 2 w (v_ref - v) + w^2 (q_ref - q)."""
    for j in range(len(a)):
        a[j] = a_ref[j] + 2.0 * w * (v_ref[j] - v[j]) + w * w * (q_ref[j] - q[j])


@kernel(types.void(VECTOR, VIEW, VIEW, _REAL, _REAL, VIEW))
def add_loads(
    tau: Array,
    load: Array,
    v: Array,
    damping: float,
    dry: float,
    tau_max: Array,
) -> None:
    """Add load (n,) and friction d v + c tanh(v / v_s) to tau (n,) and clip; tanh, because near rest the sign of v is noise."""
    for j in range(len(tau)):
        tau[j] += load[j]
        tau[j] += damping * v[j] + (dry * math.tanh(v[j] / 0.02) if dry != 0.0 else 0.0)
        tau[j] = within(tau[j], -tau_max[j], tau_max[j])


@kernel(types.void(VIEW, ROWS, ROWS, _REAL, _REAL, _REAL))
def follow_target(
    target: Array,
    state: Array,
    bounds: Array,
    w: float,
    dt: float,
    ramp_s: float,
) -> None:
    """Advance `state` (6, n) in place: q, v, a, and the ramp's start, its end and the share that is left of it.

    bounds (5, n): a_max, v_max, d, lower, upper. See `joint_control`.
    """
    q = state[0]
    v = state[1]
    start = state[3]
    end = state[4]
    left = state[5]
    for j in range(len(target)):
        a_max = bounds[0, j]
        v_max = bounds[1, j]
        near = bounds[2, j]
        if target[j] != end[j]:
            start[j] = end[j] + left[j] * (start[j] - end[j])
            end[j] = target[j]
            left[j] = 1.0
        left[j] = max(0.0, left[j] - dt / ramp_s)
        e = within(end[j] + left[j] * (start[j] - end[j]), bounds[3, j], bounds[4, j]) - q[j]
        s = near / max(abs(e), near)
        a = within(w * w * e * math.sqrt(s * (2.0 - s)) - 2.0 * w * v[j], -a_max, a_max)
        v_after = within(v[j] + dt * a, -v_max, v_max)
        state[2, j] = (v_after - v[j]) / dt  # recomputed: the speed bound may have cut it
        q[j] = q[j] + dt * v_after
        v[j] = v_after
