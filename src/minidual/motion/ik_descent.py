"""Compiled inverse kinematics of one arm (Sola, "A micro Lie theory", 2018).

Error e = log6(T_tcp_target), derivative -Jlog6(T_target_tcp) J, J in the tcp frame.
"""

import math
from typing import Any

import numpy as np
from numba import njit
from numba.core import types

from minidual.robot import vectors
from minidual.robot.compiled import BLOCKS, ROWS, VECTOR, kernel
from minidual.robot.pair import Array

_SMALL = 0.05  # below this angle [rad] series replace quotients, which lose digits
_DAMPING_FIRST = 1e-3
_DAMPING_LEAST = 1e-10
_DAMPING_MOST = 1e4
_DAMPING_DOWN = 0.2
_DAMPING_UP = 5.0
_DAMPING_PROJECT = 1e-9
_REST_ITERATIONS = 60  # step, pose and posture [m, rad]
_REST_STEP_MAX = 0.2
_REST_TOLERANCES = (1e-7, 1e-5)

Vector = tuple[float, float, float]
_algebra: Any = map(
    njit,
    (vectors.cross, vectors.inner, vectors.solve_gram, vectors.rotation_vector),
)
_cross, _dot, _solve_gram, _rotation_vector = _algebra


@njit
def _quotients(t: float) -> tuple[float, float]:
    """Return beta = (1 - (t / 2) cot(t / 2)) / t^2 and (d beta / dt) / t."""
    tt = t * t
    if t < _SMALL:
        beta = 1.0 / 12.0 + tt * (1.0 / 720.0 + tt * (1.0 / 30240.0 + tt / 1209600.0))
        return beta, 1.0 / 360.0 + tt * (1.0 / 7560.0 + tt * (1.0 / 201600.0 + tt / 5987520.0))
    sine = math.sin(0.5 * t)
    beta = (1.0 - 0.5 * t * math.cos(0.5 * t) / sine) / tt
    return beta, ((1.0 + math.sin(t) / t) / (4.0 * sine * sine) - 2.0 / tt) / tt


@njit
def _turned_back(R: Array, a: Any) -> Vector:
    return _dot(R[:, 0], a), _dot(R[:, 1], a), _dot(R[:, 2], a)


@njit
def _inverse_left(diagonal: float, beta: float, w: Vector, x: Vector) -> Vector:
    """Return diagonal x + beta w (w . x) + w / 2 x x."""
    along = beta * _dot(w, x)
    (a, b, c) = _cross(w, x)
    return (
        diagonal * x[0] + along * w[0] + 0.5 * a,
        diagonal * x[1] + along * w[1] + 0.5 * b,
        diagonal * x[2] + along * w[2] + 0.5 * c,
    )


@njit
def _reach(frames: Array, q: Array, T: Array, axes: Array) -> None:
    """Fill the tcp pose T (3, 4), joint axes and centres (n, 6), in world."""
    for r in range(3):
        for c in range(4):
            T[r, c] = 1.0 if r == c else 0.0
    for i in range(len(frames)):
        F = frames[i]
        for r in range(3):
            row = T[r, 0], T[r, 1], T[r, 2]
            T[r, 3] += _dot(row, F[:, 3])
            a = _dot(row, F[:, 0])
            b = _dot(row, F[:, 1])
            T[r, 2] = _dot(row, F[:, 2])
            if i < len(q):
                cosine = math.cos(q[i])
                sine = math.sin(q[i])
                T[r, 0], T[r, 1] = cosine * a + sine * b, cosine * b - sine * a
                axes[i, r], axes[i, 3 + r] = T[r, 2], T[r, 3]
            else:
                T[r, 0], T[r, 1] = a, b


@njit
def _measured(frames: Array, target: Array, q: Array) -> Any:
    """Return tcp pose (3, 4), joint axes and centres (n, 6), R, p and logarithm (6,) of T_tcp_target, and its angle."""
    T = np.empty((3, 4))
    axes = np.empty((len(q), 6))
    R = np.empty((3, 3))
    e = np.empty(6)
    _reach(frames, q, T, axes)
    for c in range(3):
        R[0, c], R[1, c], R[2, c] = _turned_back(T, target[:, c])
    p = _turned_back(T, (target[0, 3] - T[0, 3], target[1, 3] - T[1, 3], target[2, 3] - T[2, 3]))
    w, t = _rotation_vector(R[0], R[1], R[2])
    beta, _ = _quotients(t)
    alpha = 1.0 - beta * t * t
    along = beta * _dot(w, p)
    across = _cross(w, p)
    for k in range(3):
        e[k], e[3 + k] = alpha * p[k] - 0.5 * across[k] + along * w[k], w[k]
    return T, axes, R, p, e, t


@njit
def _jacobian(measured: Any, J: Array) -> None:
    """Fill J (6, n) = -[A, C A; 0, A] J_tcp, A and C of the inverse pose."""
    T, axes, R, p, e, t = measured
    w = (-e[3], -e[4], -e[5])
    (x, y, z) = _turned_back(R, p)
    shift = -x, -y, -z
    beta, slope = _quotients(t)
    diagonal = 1.0 - beta * t * t
    wp = _dot(w, shift)
    for i in range(J.shape[1]):
        axis = axes[i, 0], axes[i, 1], axes[i, 2]
        lever = T[0, 3] - axes[i, 3], T[1, 3] - axes[i, 4], T[2, 3] - axes[i, 5]
        a = _inverse_left(diagonal, beta, w, _turned_back(T, axis))
        b = _inverse_left(diagonal, beta, w, _turned_back(T, _cross(axis, lever)))
        # C x = u (w . x) + beta w (p . x) + beta (w . p) x + p / 2 x x
        inner = _dot(w, a)
        outer = beta * _dot(shift, a)
        across = _cross(shift, a)
        for k in range(3):
            u = slope * wp * w[k] - (t * t * slope + 2.0 * beta) * shift[k]
            J[k, i] = -(b[k] + u * inner + w[k] * outer + beta * wp * a[k] + 0.5 * across[k])
            J[3 + k, i] = -a[k]


@njit
def _inner(J: Array, i: int, e: Array) -> float:
    s = 0.0
    for k in range(6):
        s += J[k, i] * e[k]
    return s


@kernel(types.void(BLOCKS, VECTOR, ROWS), heap=True)
def tcp_pose(frames: Array, q: Array, T: Array) -> None:
    """Fill the tcp pose T (4, 4)."""
    _reach(frames, q, T, np.empty((len(q), 6)))
    for c in range(4):
        T[3, c] = 1.0 if c == 3 else 0.0


@kernel(types.void(BLOCKS, ROWS, VECTOR, VECTOR, ROWS), heap=True)
def measure(frames: Array, target: Array, q: Array, e: Array, J: Array) -> None:
    """Fill e (6,) and de/dq (6, n)."""
    measured = _measured(frames, target, q)
    _jacobian(measured, J)
    e[:] = measured[4]


@kernel(
    types.UniTuple(types.float64, 3)(
        BLOCKS,
        ROWS,
        VECTOR,
        VECTOR,
        VECTOR,
        types.int64,
        types.float64,
    ),
    heap=True,
)
def descend(
    frames: Array,
    target: Array,
    q: Array,
    lower: Array,
    upper: Array,
    iterations: int,
    tolerance: float,
) -> tuple[float, float, float]:
    """Move q (n,) towards the pose (4, 4); return the error norm, distance [m] and angle [rad].

    Levenberg-Marquardt; joints pushed against a limit stay.
    """
    n = len(q)
    damping = _DAMPING_FIRST
    J = np.empty((6, n))
    y = np.empty(6)
    q_new = np.empty(n)
    now = _measured(frames, target, q)
    cost = np.sum(now[4] ** 2)
    for _ in range(iterations):
        if cost < tolerance * tolerance or damping > _DAMPING_MOST:
            break
        _jacobian(now, J)
        for i in range(n):
            gradient = _inner(J, i, now[4])
            if (q[i] <= lower[i] and gradient > 0.0) or (q[i] >= upper[i] and gradient < 0.0):
                J[:, i] = 0.0
        if not J.any():
            break
        y[:] = now[4]
        if not _solve_gram(J, y, damping, np.empty((6, 6))):
            damping *= _DAMPING_UP
            continue
        for i in range(n):
            q_new[i] = min(max(q[i] - _inner(J, i, y), lower[i]), upper[i])
        new = _measured(frames, target, q_new)
        cost_new = np.sum(new[4] ** 2)
        if cost_new < cost:
            now = new
            cost = cost_new
            q[:] = q_new
            damping = max(damping * _DAMPING_DOWN, _DAMPING_LEAST)
        else:
            damping *= _DAMPING_UP
    p = now[3]
    return math.sqrt(cost), math.sqrt(_dot(p, p)), now[5]


@kernel(types.void(BLOCKS, ROWS, VECTOR, VECTOR, VECTOR, ROWS), heap=True)
def rest(
    frames: Array,
    target: Array,
    q: Array,
    posture: Array,
    mobility: Array,
    limits: Array,
) -> None:
    """Move q (n,) to the least sum_i (q_i - posture_i)^2 / mobility_i at the pose (4, 4).

    Gauss-Newton with null-space steps in the cost metric (Nakamura, "Advanced Robotics", 1991, ch. 4).
    """
    n = len(q)
    least = np.sqrt(mobility)
    J = np.empty((6, n))
    y = np.empty(6)
    wish = np.empty(n)
    for _ in range(_REST_ITERATIONS):
        measured = _measured(frames, target, q)
        reached = np.abs(measured[4]).max() < _REST_TOLERANCES[0]
        furthest = 0.0
        _jacobian(measured, J)
        y[:] = measured[4]
        for i in range(n):
            wish[i] = posture[i] - q[i]
            for k in range(6):
                y[k] += J[k, i] * wish[i]
                J[k, i] *= least[i]
        if not _solve_gram(J, y, _DAMPING_PROJECT, np.empty((6, 6))):
            return
        for i in range(n):
            step = wish[i] - least[i] * _inner(J, i, y)
            furthest = max(furthest, abs(step))
            q[i] = min(
                max(q[i] + min(max(step, -_REST_STEP_MAX), _REST_STEP_MAX), limits[0, i]),
                limits[1, i],
            )
        if reached and furthest < _REST_TOLERANCES[1]:
            return


@kernel(
    types.boolean(BLOCKS, ROWS, VECTOR, VECTOR, types.int64, types.float64, types.float64),
    heap=True,
)
def project(
    frames: Array,
    target: Array,
    q: Array,
    wish: Array,
    rounds: int,
    small: float,
    step_max: float,
) -> bool:
    """Move q (n,) to the pose (4, 4) by least-norm Newton steps, the first along `wish` (n,) where possible.

    Ignores limits. The step from an error below `small` is the last, as convergence is quadratic. Steps over `step_max`
    fail.
    """
    n = len(q)
    wished = (wish != 0.0).any()
    J = np.empty((6, n))
    step = np.empty(n)
    for _ in range(rounds):
        measured = _measured(frames, target, q)
        e = measured[4]
        _jacobian(measured, J)
        last = not wished and np.sum(e**2) < small * small
        if wished:
            for k in range(6):
                for i in range(n):
                    e[k] += J[k, i] * wish[i]
        if not _solve_gram(J, e, _DAMPING_PROJECT, np.empty((6, 6))):
            return False
        for i in range(n):
            step[i] = wish[i] if wished else 0.0
            for k in range(6):
                step[i] -= J[k, i] * e[k]
            q[i] += step[i]
        if not np.sum(step**2) < step_max * step_max:  # also true for NaN
            return False
        if last:
            return True
        wished = False
    return False
