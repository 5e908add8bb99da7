"""Compiled inverse kinematics of one arm (Sola, "A micro Lie theory", 2018).

Error e = log6(T_tcp_target), derivative -Jlog6(T_target_tcp) J, J in the tcp frame. `frames`
(n + 1, 4, 4) place each joint in the one before it, the last the tcp; joints turn about z.
"""

import math
from typing import Any, NamedTuple

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
_PROJECT_ITERATIONS = 8
_PROJECT_LAST = 1e-4
"""Error norm from which the next projection step is the last: convergence is quadratic."""
_PROJECT_STEP_MAX_RAD = 1.0
_REST_ITERATIONS = 60
_REST_STEP_MAX_RAD = 0.2
_REST_POSE_TOLERANCE = 1e-7  # m and rad combined
_REST_POSTURE_TOLERANCE_RAD = 1e-5

Vector = tuple[float, float, float]

_cross: Any = njit(vectors.cross)
_dot: Any = njit(vectors.inner)
_solve_gram: Any = njit(vectors.solve_gram)
_rotation_vector: Any = njit(vectors.rotation_vector)


class _TipError(NamedTuple):
    """How far the tcp is from its target.

    Attributes:
        T: Tcp pose (3, 4) in the world.
        axes: Joint axes and centres (n, 6) in the world.
        R: Orientation (3, 3) of T_tcp_target.
        p: Its position.
        e: Its logarithm (6,), [linear; angular].
        angle: Its angle [rad].
    """

    T: Array
    axes: Array
    R: Array
    p: Vector
    e: Array
    angle: float


@njit
def _quotients(t: float) -> tuple[float, float]:
    """Return beta = (1 - (t / 2) cot(t / 2)) / t^2 and (d beta / dt) / t."""
    tt = t * t
    if t < _SMALL:
        beta = 1.0 / 12.0 + tt * (1.0 / 720.0 + tt * (1.0 / 30240.0 + tt / 1209600.0))
        slope = 1.0 / 360.0 + tt * (1.0 / 7560.0 + tt * (1.0 / 201600.0 + tt / 5987520.0))
        return beta, slope
    sine = math.sin(0.5 * t)
    beta = (1.0 - 0.5 * t * math.cos(0.5 * t) / sine) / tt
    slope = ((1.0 + math.sin(t) / t) / (4.0 * sine * sine) - 2.0 / tt) / tt
    return beta, slope


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
def chain(frames: Array, q: Array, T: Array, axes: Array) -> None:
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
                T[r, 0] = cosine * a + sine * b
                T[r, 1] = cosine * b - sine * a
                axes[i, r] = T[r, 2]
                axes[i, 3 + r] = T[r, 3]
            else:
                T[r, 0] = a
                T[r, 1] = b


@njit
def _tip_error(frames: Array, target: Array, q: Array) -> Any:
    """Return the `_TipError` at q (n,) from a target pose (4, 4)."""
    T = np.empty((3, 4))
    axes = np.empty((len(q), 6))
    R = np.empty((3, 3))
    e = np.empty(6)
    chain(frames, q, T, axes)
    for c in range(3):
        R[0, c], R[1, c], R[2, c] = _turned_back(T, target[:, c])
    shift = (target[0, 3] - T[0, 3], target[1, 3] - T[1, 3], target[2, 3] - T[2, 3])
    p = _turned_back(T, shift)
    w, t = _rotation_vector(R[0], R[1], R[2])
    beta, _ = _quotients(t)
    alpha = 1.0 - beta * t * t
    along = beta * _dot(w, p)
    across = _cross(w, p)
    for k in range(3):
        e[k] = alpha * p[k] - 0.5 * across[k] + along * w[k]
        e[3 + k] = w[k]
    return _TipError(T, axes, R, p, e, t)


@njit
def _jacobian(tip: Any, J: Array) -> None:
    """Fill J (6, n) = -[A, C A; 0, A] J_tcp, A and C of the inverse pose."""
    T = tip.T
    axes = tip.axes
    t = tip.angle
    w = (-tip.e[3], -tip.e[4], -tip.e[5])
    (x, y, z) = _turned_back(tip.R, tip.p)
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
    """Return column i of J (6, n) times e (6,)."""
    s = 0.0
    for k in range(6):
        s += J[k, i] * e[k]
    return s


@kernel(types.void(BLOCKS, VECTOR, ROWS), heap=True)
def tcp_pose(frames: Array, q: Array, T: Array) -> None:
    """Fill the tcp pose T (4, 4)."""
    chain(frames, q, T, np.empty((len(q), 6)))
    for c in range(4):
        T[3, c] = 1.0 if c == 3 else 0.0


@kernel(types.void(BLOCKS, ROWS, VECTOR, VECTOR, ROWS), heap=True)
def measure(frames: Array, target: Array, q: Array, e: Array, J: Array) -> None:
    """Fill e (6,) and de/dq (6, n)."""
    tip = _tip_error(frames, target, q)
    _jacobian(tip, J)
    e[:] = tip.e


_DESCENT = types.UniTuple(types.float64, 3)(
    BLOCKS,
    ROWS,
    VECTOR,
    ROWS,
    types.int64,
    types.float64,
)


@kernel(_DESCENT, heap=True)
def descend(
    frames: Array,
    target: Array,
    q: Array,
    limits: Array,
    iterations: int,
    tolerance: float,
) -> tuple[float, float, float]:
    """Move q (n,) towards the pose (4, 4) within the limits (2, n), lower first [rad].

    Levenberg-Marquardt; joints pushed against a limit stay.

    Returns:
        The error norm, its distance [m] and angle [rad].
    """
    n = len(q)
    lower = limits[0]
    upper = limits[1]
    damping = _DAMPING_FIRST
    J = np.empty((6, n))
    y = np.empty(6)
    q_new = np.empty(n)
    tip = _tip_error(frames, target, q)
    cost = np.sum(tip.e**2)
    for _ in range(iterations):
        if cost < tolerance * tolerance or damping > _DAMPING_MOST:
            break
        _jacobian(tip, J)
        for i in range(n):
            gradient = _inner(J, i, tip.e)
            at_lower = q[i] <= lower[i] and gradient > 0.0
            at_upper = q[i] >= upper[i] and gradient < 0.0
            if at_lower or at_upper:
                J[:, i] = 0.0
        if not J.any():
            break
        y[:] = tip.e
        if not _solve_gram(J, y, damping, np.empty((6, 6))):
            damping *= _DAMPING_UP
            continue
        for i in range(n):
            q_new[i] = min(max(q[i] - _inner(J, i, y), lower[i]), upper[i])
        new = _tip_error(frames, target, q_new)
        cost_new = np.sum(new.e**2)
        if cost_new < cost:
            tip = new
            cost = cost_new
            q[:] = q_new
            damping = max(damping * _DAMPING_DOWN, _DAMPING_LEAST)
        else:
            damping *= _DAMPING_UP
    p = tip.p
    return math.sqrt(cost), math.sqrt(_dot(p, p)), tip.angle


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

    `limits` (2, n), lower first [rad]. Gauss-Newton with null-space steps in the cost metric
    (Nakamura, "Advanced Robotics", 1991, ch. 4).
    """
    n = len(q)
    lower = limits[0]
    upper = limits[1]
    weight = np.sqrt(mobility)
    J = np.empty((6, n))
    y = np.empty(6)
    wish = np.empty(n)
    for _ in range(_REST_ITERATIONS):
        tip = _tip_error(frames, target, q)
        reached = np.abs(tip.e).max() < _REST_POSE_TOLERANCE
        furthest = 0.0
        _jacobian(tip, J)
        y[:] = tip.e
        for i in range(n):
            wish[i] = posture[i] - q[i]
            for k in range(6):
                y[k] += J[k, i] * wish[i]
                J[k, i] *= weight[i]
        if not _solve_gram(J, y, _DAMPING_PROJECT, np.empty((6, 6))):
            return
        for i in range(n):
            step = wish[i] - weight[i] * _inner(J, i, y)
            furthest = max(furthest, abs(step))
            bounded = min(max(step, -_REST_STEP_MAX_RAD), _REST_STEP_MAX_RAD)
            q[i] = min(max(q[i] + bounded, lower[i]), upper[i])
        if reached and furthest < _REST_POSTURE_TOLERANCE_RAD:
            return


@kernel(types.boolean(BLOCKS, ROWS, VECTOR, VECTOR), heap=True)
def project(frames: Array, target: Array, q: Array, wish: Array) -> bool:
    """Move q (n,) to the pose (4, 4) by least-norm Newton steps.

    The first step is along `wish` (n,) [rad] where possible. Limits are ignored. Steps over 1 rad
    fail.
    """
    n = len(q)
    wished = (wish != 0.0).any()
    J = np.empty((6, n))
    step = np.empty(n)
    for _ in range(_PROJECT_ITERATIONS):
        tip = _tip_error(frames, target, q)
        e = tip.e
        _jacobian(tip, J)
        last = not wished and np.sum(e**2) < _PROJECT_LAST * _PROJECT_LAST
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
        # Also true for NaN.
        if not np.sum(step**2) < _PROJECT_STEP_MAX_RAD * _PROJECT_STEP_MAX_RAD:
            return False
        if last:
            return True
        wished = False
    return False
