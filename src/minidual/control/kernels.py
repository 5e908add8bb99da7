"""Compiled control-law algebra: about 1 us a call instead of hundreds of Python operations.

Vectors of three are tuples, kept in registers. All helpers must live in this file: numba's cache tracks no other.
Import late: it imports numba.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import from_dtype, njit
from numba.core import types

from minidual.robot.compiled import kernel
from minidual.robot.pair import Array

LAW = np.dtype(
    [
        # Set once.
        ("K", "f8", 6),
        ("D", "f8", 6),
        ("mass", "f8"),
        ("inertia", "f8", (3, 3)),
        ("axis", "f8", 3),
        ("gravity", "f8", 3),
        ("R_hand_object", "f8", (2, 3, 3)),
        ("hand_stiffness", "f8"),
        ("hand_damping", "f8"),
        ("posture_stiffness", "f8"),
        ("posture_damping", "f8"),
        ("smooth", "f8"),
        # Measured and desired.
        ("squeeze", "f8"),
        ("T", "f8", (4, 4)),
        ("twist", "f8", 6),
        ("T_d", "f8", (4, 4)),
        ("twist_d", "f8", 6),
        ("a_d", "f8", 6),
        ("a_hands", "f8", 12),
        # Result.
        ("f", "f8", 12),
    ]
)
"""The object impedance's object and hand data."""

ROWS = ("posture", "viscous", "dry", "tau_max", "q", "v", "qdd_posture", "qdd", "push")
"""Its joint data, (rows, n)."""
POSTURE, VISCOUS, DRY, TAU_MAX, Q, V, QDD_POSTURE, QDD, PUSH = range(len(ROWS))

Vector = tuple[float, float, float]
"""Helpers that only read also take arrays (`Elements`)."""
Elements = Any

_LAW = types.Array(from_dtype(LAW), 1, "C")
_VECTOR = types.float64[::1]
_MATRIX = types.float64[:, ::1]
_ROTATION = types.float64[::1, :]
"""Pinocchio's matrices are column-major."""


def view(law: npt.NDArray[np.void]) -> dict[str, Any]:
    """Return numpy views of the fields of law (1,)."""
    return {name: law[name][0] if law[name].ndim > 1 else law[name] for name in LAW.names or ()}


@njit
def vector(a: Elements, i: int = 0) -> Vector:
    """Return a[i : i + 3] as a tuple."""
    return a[i], a[i + 1], a[i + 2]


@njit
def plus(a: Elements, b: Elements) -> Vector:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit
def minus(a: Elements, b: Elements) -> Vector:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit
def times(s: float, a: Elements) -> Vector:
    """Return s a."""
    return s * a[0], s * a[1], s * a[2]


@njit
def dot(a: Elements, b: Elements) -> float:
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit
def cross(a: Elements, b: Elements) -> Vector:
    """Return a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit
def scaled(d: Elements, a: Elements) -> Vector:
    """Return diag(d) a."""
    return d[0] * a[0], d[1] * a[1], d[2] * a[2]


@njit
def apply(A: Array, x: Elements) -> Vector:
    """Return A x."""
    return dot(A[0], x), dot(A[1], x), dot(A[2], x)


@njit
def apply_transposed(A: Array, x: Elements) -> Vector:
    """Return A^T x."""
    return dot(A[:, 0], x), dot(A[:, 1], x), dot(A[:, 2], x)


@njit
def within(x: float, low: float, high: float) -> float:
    """Return x clipped; NaN stays NaN."""
    return high if x > high else low if x < low else x


@njit
def rotation_vector(Ex: Vector, Ey: Vector, Ez: Vector) -> Vector:
    """Return the rotation vector [rad] of the matrix with these rows."""
    vee = (Ez[1] - Ey[2], Ex[2] - Ez[0], Ey[0] - Ex[1])
    sine = 0.5 * math.sqrt(dot(vee, vee))
    cosine = 0.5 * (Ex[0] + Ey[1] + Ez[2] - 1.0)
    angle = math.atan2(sine, cosine)
    if angle > math.pi - 1e-4:
        # `vee` is inaccurate here: the axis is the longest column of (E + E^T) / 2 - cos I ~ axis axis^T.
        a, b, c = 0.5 * (Ex[1] + Ey[0]), 0.5 * (Ex[2] + Ez[0]), 0.5 * (Ey[2] + Ez[1])
        u, v, w = Ex[0] - cosine, Ey[1] - cosine, Ez[2] - cosine
        axis = (u, a, b) if u >= v and u >= w else (a, v, c) if v >= w else (b, c, w)
        sign = 1.0 if dot(vee, axis) >= 0.0 else -1.0
        return times(sign * angle / math.sqrt(dot(axis, axis)), axis)
    return times(0.5 * angle / sine if sine > 1e-12 else 0.5, vee)


@njit
def row_by(wanted: Array, i: int, x: Vector, y: Vector, z: Vector) -> Vector:
    """Return row i of `wanted` [x y z]^T."""
    return plus(times(wanted[i, 0], x), plus(times(wanted[i, 1], y), times(wanted[i, 2], z)))


@njit
def friction(v: float, d: float, c: float, smooth: float) -> float:
    """Return d v + c tanh(v / v_s)."""
    return d * v + c * math.tanh(v / smooth) if c != 0.0 else d * v


@njit
def turn(wanted: Array, x: Vector, y: Vector, z: Vector) -> Vector:
    """Return log(wanted actual^T) [rad], actual = [x y z]."""
    return rotation_vector(row_by(wanted, 0, x, y, z), row_by(wanted, 1, x, y, z), row_by(wanted, 2, x, y, z))


@njit
def hand_wrenches(force: Vector, moment: Vector, r_left: Vector, r_right: Vector, squeeze: Vector, f: Array) -> None:
    """Fill f (12,) with G^+ w + (I - G^+ G) [-squeeze; 0; squeeze; 0] (docs/force-control.md)."""
    m, h = times(0.5, plus(r_left, r_right)), times(0.5, minus(r_left, r_right))
    n = plus(minus(moment, cross(m, force)), times(2.0, cross(h, squeeze)))
    share = times(0.5 / (1.0 + dot(h, h)), plus(n, times(dot(h, n), h)))
    press = minus(cross(share, h), squeeze)
    half = times(0.5, force)
    f[0:3], f[3:6] = plus(half, press), share
    f[6:9], f[9:12] = minus(half, press), share


@njit
def least_norm(J: Array, b: Array, x: Array) -> bool:
    """Fill x (n,) with J^T (J J^T)^-1 b, J (6, n); return whether J has full rank."""
    L, y = np.empty((6, 6)), np.empty(6)
    for i in range(6):
        for j in range(i + 1):
            s = 0.0
            for k in range(J.shape[1]):
                s += J[i, k] * J[j, k]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = s / L[j, j]
            elif s > 0.0:
                L[i, i] = math.sqrt(s)
            else:  # also NaN
                return False
    for i in range(6):  # L y = b
        y[i] = b[i]
        for k in range(i):
            y[i] -= L[i, k] * y[k]
        y[i] /= L[i, i]
    for i in range(5, -1, -1):  # L^T y' = y, in place
        for k in range(i + 1, 6):
            y[i] -= L[k, i] * y[k]
        y[i] /= L[i, i]
    for k in range(J.shape[1]):
        x[k] = 0.0
        for i in range(6):
            x[k] += J[i, k] * y[i]
    return True


@kernel(types.void(_LAW, _MATRIX))
def posture_acceleration(law: Array, rows: Array) -> None:
    """Fill qdd_posture: a damped joint spring."""
    s = law[0]
    for i in range(rows.shape[1]):
        spring = s.posture_stiffness * (rows[POSTURE, i] - rows[Q, i])
        rows[QDD_POSTURE, i] = spring - s.posture_damping * rows[V, i]


@kernel(types.boolean(_LAW, _MATRIX, _MATRIX, _VECTOR, _VECTOR, _ROTATION, _ROTATION))
def impedance(
    law: Array, rows: Array, jacobian: Array, p_left: Array, p_right: Array, R_left: Array, R_right: Array
) -> bool:
    """Fill f, push = J^T f and qdd; return False if singular."""
    s = law[0]
    R, p = s.T, (s.T[0, 3], s.T[1, 3], s.T[2, 3])
    R_d, p_d = s.T_d, (s.T_d[0, 3], s.T_d[1, 3], s.T_d[2, 3])
    x, y, z = (R[0, 0], R[1, 0], R[2, 0]), (R[0, 1], R[1, 1], R[2, 1]), (R[0, 2], R[1, 2], R[2, 2])
    a, alpha, omega = vector(s.a_d), vector(s.a_d, 3), vector(s.twist_d, 3)

    # Wrench on the object: w = K e + D (V_d - V) + [m (a_d - g); I_w alpha + omega x I_w omega].
    force = scaled(vector(s.K), minus(p_d, p))
    force = plus(force, scaled(vector(s.D), minus(vector(s.twist_d), vector(s.twist))))
    force = plus(force, times(s.mass, minus(a, vector(s.gravity))))
    moment = scaled(vector(s.K, 3), turn(R_d, x, y, z))
    moment = plus(moment, scaled(vector(s.D, 3), minus(omega, vector(s.twist, 3))))
    I_alpha = apply(R, apply(s.inertia, apply_transposed(R, alpha)))
    I_omega = apply(R, apply(s.inertia, apply_transposed(R, omega)))
    moment = plus(moment, plus(I_alpha, cross(omega, I_omega)))

    # Distribution over the hands, and the squeeze.
    r = minus(vector(p_left), p), minus(vector(p_right), p)
    f = s.f
    hand_wrenches(force, moment, r[0], r[1], times(s.squeeze, apply(R, s.axis)), f)

    n = rows.shape[1] // 2
    lacking = np.empty(6)
    for i, R_hand in enumerate((R_left, R_right)):
        J = jacobian[6 * i : 6 * i + 6, n * i : n * (i + 1)]
        v, qdd = rows[V, n * i : n * (i + 1)], rows[QDD, n * i : n * (i + 1)]

        # Torsional spring from the object orientation implied by this hand's grasp to the desired one.
        B = s.R_hand_object[i]
        error = turn(R_d, apply(R_hand, B[:, 0]), apply(R_hand, B[:, 1]), apply(R_hand, B[:, 2]))
        for k in range(3):
            rate = omega[k]
            for j in range(n):
                rate -= J[3 + k, j] * v[j]
            f[6 * i + 3 + k] += s.hand_stiffness * error[k] + s.hand_damping * rate

        # qdd = qdd_posture + J^+ (a_hand - J qdd_posture - Jdot v): only null-space posture motion remains.
        lacking[0:3] = plus(a, plus(cross(alpha, r[i]), cross(omega, cross(omega, r[i]))))
        lacking[3:6] = alpha
        for k in range(6):
            lacking[k] -= s.a_hands[6 * i + k]
        if not least_norm(J, lacking, qdd):
            return False

    for j in range(rows.shape[1]):
        rows[QDD, j] += rows[QDD_POSTURE, j]
        rows[PUSH, j] = 0.0
        for k in range(12):
            rows[PUSH, j] += jacobian[k, j] * f[k]
    return True


@kernel(types.void(_LAW, _MATRIX, _VECTOR))
def add_push(law: Array, rows: Array, tau: Array) -> None:
    """Add push and friction to tau (n,) and clip."""
    smooth = law[0].smooth
    for j in range(len(tau)):
        tau[j] += rows[PUSH, j] + friction(rows[V, j], rows[VISCOUS, j], rows[DRY, j], smooth)
        tau[j] = within(tau[j], -rows[TAU_MAX, j], rows[TAU_MAX, j])


@kernel(types.void(_VECTOR, _VECTOR, _MATRIX, types.float64))
def add_friction(tau: Array, v: Array, joints: Array, smooth: float) -> None:
    """Add friction to tau (n,) and clip; joints (3, n): d, c, tau_max."""
    for j in range(len(tau)):
        tau[j] += friction(v[j], joints[0, j], joints[1, j], smooth)
        tau[j] = within(tau[j], -joints[2, j], joints[2, j])


@kernel(types.void(_VECTOR, _VECTOR, _VECTOR, _MATRIX, types.float64, types.float64, _MATRIX))
def follow_target(target: Array, q: Array, v: Array, bounds: Array, w: float, dt: float, after: Array) -> None:
    """Fill `after` (3, n) with the next q, v, a (see `reference`).

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
