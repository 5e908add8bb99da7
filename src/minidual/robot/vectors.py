"""Vectors of three floats, and small linear systems; also for kernels.

`np.cross` takes 14 us, `cross` 0.13 us.
"""

import math
from collections.abc import Sequence

from minidual.robot.pair import Array

Vector = Sequence[float]
"""From `array.tolist()`."""


def cross(a: Vector, b: Vector) -> tuple[float, float, float]:
    """Return a x b."""
    ax, ay, az = a
    bx, by, bz = b
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def plus(a: Vector, b: Vector) -> tuple[float, float, float]:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def minus(a: Vector, b: Vector) -> tuple[float, float, float]:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def times(s: float, a: Vector) -> tuple[float, float, float]:
    """Return s a."""
    return s * a[0], s * a[1], s * a[2]


def inner(a: Vector, b: Vector) -> float:
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


_NEAR_HALF_TURN = math.pi - 1e-3
"""Above this angle [rad] the antisymmetric part of a rotation loses digits."""


def rotation_vector(X: Vector, Y: Vector, Z: Vector) -> tuple[tuple[float, float, float], float]:
    """Return the rotation vector (3,) [rad] of a matrix with these rows, and its angle, 0 to pi."""
    x = 0.5 * (Z[1] - Y[2])
    y = 0.5 * (X[2] - Z[0])
    z = 0.5 * (Y[0] - X[1])
    size = math.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (X[0] + Y[1] + Z[2] - 1.0)
    angle = math.atan2(size, cosine)
    if angle > _NEAR_HALF_TURN:
        # The axis is along the longest row of (R + R^T) / 2 - cos(angle) 1 ~ axis axis^T.
        a = 0.5 * (Y[2] + Z[1])
        b = 0.5 * (X[2] + Z[0])
        c = 0.5 * (X[1] + Y[0])
        if X[0] >= max(Y[1], Z[2]):
            longest = (X[0] - cosine, c, b)
        elif Y[1] >= Z[2]:
            longest = (c, Y[1] - cosine, a)
        else:
            longest = (b, a, Z[2] - cosine)
        u, v, w = longest
        size = math.copysign(math.sqrt(u * u + v * v + w * w), x * u + y * v + z * w)
        x = u
        y = v
        z = w
    factor = angle / size if abs(size) > 1e-12 else 1.0
    return (factor * x, factor * y, factor * z), angle


def larger(x: float, y: float) -> float:
    """Return the larger; NaN stays NaN."""
    return x if x > y or x != x else y


def solve_gram(J: Array, y: Array, damping: float, L: Array) -> bool:
    """Solve (J J^T + damping) x = y in place; return False if J (6, n) has lost a rank.

    Args:
        J: (6, n).
        y: (6,), replaced by x.
        damping: Added to the diagonal.
        L: (6, 6), overwritten by the Cholesky factor.
    """
    for i in range(6):
        for j in range(i + 1):
            s = damping if i == j else 0.0
            for k in range(J.shape[1]):
                s += J[i, k] * J[j, k]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j and s <= 0.0:  # false for NaN: the supervisor must see it
                return False
            L[i, j] = math.sqrt(s) if i == j else s / L[j, j]
            if j < i:
                y[i] -= L[i, j] * y[j]
        y[i] /= L[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            y[i] -= L[k, i] * y[k]
        y[i] /= L[i, i]
    return True
