"""Vectors of three plain floats, for code that runs a thousand times a second.

On three numbers an array operation spends its time on being called: `np.cross` takes 14 us, `cross` 0.13 us. Larger
algebra belongs to numpy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from minidual.robot.pair import Array
from minidual.robot.poses import rotation_log

Vector = Sequence[float]
"""Three floats; `array.tolist()` makes one."""
Matrix = Sequence[Vector]
"""Three rows."""
ZERO: tuple[float, float, float] = (0.0, 0.0, 0.0)

_NEAR_HALF_TURN = -0.99
"""Cosine of the angle under which the antisymmetric part of a rotation has too few digits left."""


def parts(T: Array) -> tuple[Matrix, Vector]:
    """Return rotation and position of a (4, 4) pose."""
    (a, b, c, x), (d, e, f, y), (g, h, i, z), _ = T.tolist()
    return ((a, b, c), (d, e, f), (g, h, i)), (x, y, z)


def cross(a: Vector, b: Vector) -> tuple[float, float, float]:
    """Return a x b."""
    ax, ay, az = a
    bx, by, bz = b
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def plus(a: Vector, b: Vector) -> tuple[float, float, float]:
    """Return a + b."""
    ax, ay, az = a
    bx, by, bz = b
    return ax + bx, ay + by, az + bz


def minus(a: Vector, b: Vector) -> tuple[float, float, float]:
    """Return a - b."""
    ax, ay, az = a
    bx, by, bz = b
    return ax - bx, ay - by, az - bz


def times(s: float, a: Vector) -> tuple[float, float, float]:
    """Return s a."""
    x, y, z = a
    return s * x, s * y, s * z


def mix(s: float, a: Vector, t: float, b: Vector) -> tuple[float, float, float]:
    """Return s a + t b."""
    ax, ay, az = a
    bx, by, bz = b
    return s * ax + t * bx, s * ay + t * by, s * az + t * bz


def inner(a: Vector, b: Vector) -> float:
    """Return a . b."""
    ax, ay, az = a
    bx, by, bz = b
    return ax * bx + ay * by + az * bz


def apply(A: Matrix, x: Vector) -> tuple[float, float, float]:
    """Return A x of a (3, 3) matrix."""
    (a, b, c), (d, e, f), (g, h, i) = A
    x1, x2, x3 = x
    return a * x1 + b * x2 + c * x3, d * x1 + e * x2 + f * x3, g * x1 + h * x2 + i * x3


def apply_transposed(A: Matrix, x: Vector) -> tuple[float, float, float]:
    """Return A^T x of a (3, 3) matrix: of a rotation, the way back."""
    (a, b, c), (d, e, f), (g, h, i) = A
    x1, x2, x3 = x
    return a * x1 + d * x2 + g * x3, b * x1 + e * x2 + h * x3, c * x1 + f * x2 + i * x3


def rotation_error(wanted: Matrix, actual: Matrix) -> tuple[float, float, float]:
    """Return log(wanted actual^T) [rad]: the rotation vector, in world axes, that turns `actual` into `wanted`.

    sin(angle) axis is half the vector of the antisymmetric part, cos(angle) follows from the trace (Rodrigues).
    """
    (a, b, c), (d, e, f), (g, h, i) = wanted
    (k, u, m), (n, o, p), (q, r, s) = actual
    x = g * n + h * o + i * p - d * q - e * r - f * s
    y = a * q + b * r + c * s - g * k - h * u - i * m
    z = d * k + e * u + f * m - a * n - b * o - c * p
    sine = 0.5 * math.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (a * k + b * u + c * m + d * n + e * o + f * p + g * q + h * r + i * s - 1.0)
    if cosine < _NEAR_HALF_TURN:
        x, y, z = rotation_log(np.array(wanted) @ np.array(actual).T).tolist()
        return x, y, z
    factor = 0.5 * math.atan2(sine, cosine) / sine if sine > 1e-12 else 0.5
    return factor * x, factor * y, factor * z
