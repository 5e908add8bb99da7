"""Compiled inverse kinematics of one arm (Sola, "A micro Lie theory", 2018).

Error e = log6(T_tcp_target), derivative -Jlog6(T_target_tcp) J, J in the tcp frame.
"""

import math
from typing import Any

import numpy as np
from numba import njit
from numba.core import types

from minidual.robot.compiled import BLOCKS, ROWS, VECTOR, kernel
from minidual.robot.pair import Array

_SMALL = 0.05  # below this angle [rad] series replace quotients, which lose digits
_NEAR_HALF_TURN = math.pi - 1e-3  # above this angle [rad] a rotation's antisymmetric part loses digits
_DAMPING_FIRST, _DAMPING_LEAST, _DAMPING_MOST = 1e-3, 1e-10, 1e4
_DAMPING_DOWN, _DAMPING_UP = 0.2, 5.0
_DAMPING_PROJECT = 1e-9


@njit
def _logarithm(R: Array, w: Array) -> float:
    """Fill the rotation vector w (3,) of R; return its angle, 0 to pi."""
    x, y, z = 0.5 * (R[2, 1] - R[1, 2]), 0.5 * (R[0, 2] - R[2, 0]), 0.5 * (R[1, 0] - R[0, 1])
    sine = math.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    angle = math.atan2(sine, cosine)
    if angle > _NEAR_HALF_TURN:
        # The longest column of (R + R^T) / 2 - cos I ~ axis axis^T.
        i = 0
        for k in range(1, 3):
            if R[k, k] > R[i, i]:
                i = k
        for k in range(3):
            w[k] = 0.5 * (R[i, k] + R[k, i]) - (cosine if i == k else 0.0)
        size = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
        along = angle if w[0] * x + w[1] * y + w[2] * z >= 0.0 else -angle
        for k in range(3):
            w[k] *= along / size
        return angle
    factor = angle / sine if sine > 1e-12 else 1.0
    w[0], w[1], w[2] = factor * x, factor * y, factor * z
    return angle


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
def _reach(frames: Array, q: Array, T: Array, axes: Array) -> None:
    """Fill the tcp pose T (3, 4), joint axes and centres (n, 6), in world."""
    for r in range(3):
        for c in range(4):
            T[r, c] = 1.0 if r == c else 0.0
    for i in range(len(frames)):
        F = frames[i]
        for r in range(3):
            x, y, z = T[r, 0], T[r, 1], T[r, 2]
            T[r, 3] += x * F[0, 3] + y * F[1, 3] + z * F[2, 3]
            a = x * F[0, 0] + y * F[1, 0] + z * F[2, 0]
            b = x * F[0, 1] + y * F[1, 1] + z * F[2, 1]
            T[r, 2] = x * F[0, 2] + y * F[1, 2] + z * F[2, 2]
            if i < len(q):
                cosine, sine = math.cos(q[i]), math.sin(q[i])
                T[r, 0], T[r, 1] = cosine * a + sine * b, cosine * b - sine * a
                axes[i, r], axes[i, 3 + r] = T[r, 2], T[r, 3]
            else:
                T[r, 0], T[r, 1] = a, b


@njit
def _measured(frames: Array, target: Array, q: Array) -> Any:
    """Return tcp pose (3, 4), joint axes and centres (n, 6), R, p and logarithm (6,) of T_tcp_target, and its angle."""
    T, axes, R, p, e = np.empty((3, 4)), np.empty((len(q), 6)), np.empty((3, 3)), np.zeros(3), np.empty(6)
    _reach(frames, q, T, axes)
    for r in range(3):
        for k in range(3):
            p[r] += T[k, r] * (target[k, 3] - T[k, 3])
        for c in range(3):
            R[r, c] = T[0, r] * target[0, c] + T[1, r] * target[1, c] + T[2, r] * target[2, c]
    w = e[3:]
    t = _logarithm(R, w)
    beta, _ = _quotients(t)
    alpha = 1.0 - beta * t * t
    along = beta * (w[0] * p[0] + w[1] * p[1] + w[2] * p[2])
    e[0] = alpha * p[0] - 0.5 * (w[1] * p[2] - w[2] * p[1]) + along * w[0]
    e[1] = alpha * p[1] - 0.5 * (w[2] * p[0] - w[0] * p[2]) + along * w[1]
    e[2] = alpha * p[2] - 0.5 * (w[0] * p[1] - w[1] * p[0]) + along * w[2]
    return T, axes, R, p, e, t


@njit
def _jacobian(measured: Any, J: Array) -> None:
    """Fill J (6, n) = -[A, C A; 0, A] J_tcp, A and C of the inverse pose."""
    T, axes, R, p, e, t = measured
    wx, wy, wz = -e[3], -e[4], -e[5]
    px = -(R[0, 0] * p[0] + R[1, 0] * p[1] + R[2, 0] * p[2])
    py = -(R[0, 1] * p[0] + R[1, 1] * p[1] + R[2, 1] * p[2])
    pz = -(R[0, 2] * p[0] + R[1, 2] * p[1] + R[2, 2] * p[2])
    beta, slope = _quotients(t)
    diagonal = 1.0 - beta * t * t
    wp = wx * px + wy * py + wz * pz
    turn, shift = slope * wp, -(t * t * slope + 2.0 * beta)
    ux, uy, uz = turn * wx + shift * px, turn * wy + shift * py, turn * wz + shift * pz
    straight = beta * wp
    for i in range(J.shape[1]):
        # Joint twist in the tcp frame: v = R^T (z x (p_tcp - p_joint)), o = R^T z.
        zx, zy, zz = axes[i, 0], axes[i, 1], axes[i, 2]
        dx, dy, dz = T[0, 3] - axes[i, 3], T[1, 3] - axes[i, 4], T[2, 3] - axes[i, 5]
        mx, my, mz = zy * dz - zz * dy, zz * dx - zx * dz, zx * dy - zy * dx
        vx = T[0, 0] * mx + T[1, 0] * my + T[2, 0] * mz
        vy = T[0, 1] * mx + T[1, 1] * my + T[2, 1] * mz
        vz = T[0, 2] * mx + T[1, 2] * my + T[2, 2] * mz
        ox = T[0, 0] * zx + T[1, 0] * zy + T[2, 0] * zz
        oy = T[0, 1] * zx + T[1, 1] * zy + T[2, 1] * zz
        oz = T[0, 2] * zx + T[1, 2] * zy + T[2, 2] * zz
        # A x = diagonal x + beta w (w . x) + w / 2 x x
        along = beta * (wx * ox + wy * oy + wz * oz)
        ax = diagonal * ox + along * wx + 0.5 * (wy * oz - wz * oy)
        ay = diagonal * oy + along * wy + 0.5 * (wz * ox - wx * oz)
        az = diagonal * oz + along * wz + 0.5 * (wx * oy - wy * ox)
        along = beta * (wx * vx + wy * vy + wz * vz)
        bx = diagonal * vx + along * wx + 0.5 * (wy * vz - wz * vy)
        by = diagonal * vy + along * wy + 0.5 * (wz * vx - wx * vz)
        bz = diagonal * vz + along * wz + 0.5 * (wx * vy - wy * vx)
        # C x = u (w . x) + beta w (p . x) + beta (w . p) x + p / 2 x x
        inner, outer = wx * ax + wy * ay + wz * az, beta * (px * ax + py * ay + pz * az)
        J[0, i] = -(bx + ux * inner + wx * outer + straight * ax + 0.5 * (py * az - pz * ay))
        J[1, i] = -(by + uy * inner + wy * outer + straight * ay + 0.5 * (pz * ax - px * az))
        J[2, i] = -(bz + uz * inner + wz * outer + straight * az + 0.5 * (px * ay - py * ax))
        J[3, i], J[4, i], J[5, i] = -ax, -ay, -az


@njit
def _inner(J: Array, i: int, e: Array) -> float:
    s = 0.0
    for k in range(6):
        s += J[k, i] * e[k]
    return s


@njit
def _solve(J: Array, blocked: Any, damping: float, e: Array, L: Array, y: Array) -> None:
    """Fill y = (J J^T + damping I)^-1 e without blocked columns; NaN on failure."""
    for i in range(6):
        for j in range(i + 1):
            s = damping if i == j else 0.0
            for k in range(J.shape[1]):
                if not blocked[k]:
                    s += J[i, k] * J[j, k]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            L[i, j] = math.sqrt(s) if i == j else s / L[j, j]
    for i in range(6):
        y[i] = e[i]
        for k in range(i):
            y[i] -= L[i, k] * y[k]
        y[i] /= L[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            y[i] -= L[k, i] * y[k]
        y[i] /= L[i, i]


@kernel(types.void(BLOCKS, VECTOR, ROWS))
def tcp_pose(frames: Array, q: Array, T: Array) -> None:
    """Fill the tcp pose T (4, 4)."""
    _reach(frames, q, T, np.empty((len(q), 6)))
    for c in range(4):
        T[3, c] = 1.0 if c == 3 else 0.0


@kernel(types.void(BLOCKS, ROWS, VECTOR, VECTOR, ROWS))
def measure(frames: Array, target: Array, q: Array, e: Array, J: Array) -> None:
    """Fill e (6,) and de/dq (6, n)."""
    measured = _measured(frames, target, q)
    _jacobian(measured, J)
    e[:] = measured[4]


@kernel(types.UniTuple(types.float64, 3)(BLOCKS, ROWS, VECTOR, VECTOR, VECTOR, types.int64, types.float64))
def descend(
    frames: Array, target: Array, q: Array, lower: Array, upper: Array, iterations: int, tolerance: float
) -> tuple[float, float, float]:
    """Move q (n,) towards the pose (4, 4); return the error norm, distance [m] and angle [rad].

    Levenberg-Marquardt; joints pushed against a limit stay.
    """
    n, damping = len(q), _DAMPING_FIRST
    J, L, y, q_new, blocked = np.empty((6, n)), np.zeros((6, 6)), np.empty(6), np.empty(n), np.empty(n, dtype=np.bool_)
    now = _measured(frames, target, q)
    cost = np.sum(now[4] ** 2)
    for _ in range(iterations):
        if cost < tolerance * tolerance or damping > _DAMPING_MOST:
            break
        _jacobian(now, J)
        for i in range(n):
            gradient = _inner(J, i, now[4])
            blocked[i] = (q[i] <= lower[i] and gradient > 0.0) or (q[i] >= upper[i] and gradient < 0.0)
        if blocked.all():
            break
        _solve(J, blocked, damping, now[4], L, y)
        for i in range(n):
            step = 0.0 if blocked[i] else _inner(J, i, y)
            q_new[i] = min(max(q[i] - step, lower[i]), upper[i])
        new = _measured(frames, target, q_new)
        cost_new = np.sum(new[4] ** 2)
        if cost_new < cost:
            now, cost = new, cost_new
            q[:] = q_new
            damping = max(damping * _DAMPING_DOWN, _DAMPING_LEAST)
        else:
            damping *= _DAMPING_UP
    p = now[3]
    return math.sqrt(cost), math.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]), now[5]


@kernel(types.boolean(BLOCKS, ROWS, VECTOR, VECTOR, types.int64, types.float64, types.float64))
def project(
    frames: Array, target: Array, q: Array, wish: Array, iterations: int, small: float, step_max: float
) -> bool:
    """Move q (n,) to the pose (4, 4) by least-norm Newton steps, the first along `wish` (n,) where possible.

    Ignores limits. The step from an error below `small` is the last, as convergence is quadratic. Steps over `step_max`
    fail.
    """
    n, wished = len(q), (wish != 0.0).any()
    J, L, y, step, blocked = np.empty((6, n)), np.zeros((6, 6)), np.empty(6), np.empty(n), np.zeros(n, dtype=np.bool_)
    for _ in range(iterations):
        measured = _measured(frames, target, q)
        e = measured[4]
        _jacobian(measured, J)
        last = not wished and np.sum(e**2) < small * small
        if wished:
            for k in range(6):
                for i in range(n):
                    e[k] += J[k, i] * wish[i]
        _solve(J, blocked, _DAMPING_PROJECT, e, L, y)
        for i in range(n):
            step[i] = wish[i] if wished else 0.0
            for k in range(6):
                step[i] -= J[k, i] * y[k]
            q[i] += step[i]
        if not np.sum(step**2) < step_max * step_max:  # also true for NaN
            return False
        if last:
            return True
        wished = False
    return False
