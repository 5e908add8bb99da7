"""Vectors of three plain floats, for code that runs a thousand times a second.

On three numbers an array operation spends its time on being called: `np.cross` takes 14 us, `cross` 0.13 us. Larger
algebra belongs to numpy.
"""

from __future__ import annotations

from collections.abc import Sequence

Vector = Sequence[float]
"""Three floats; `array.tolist()` makes one. A matrix is a sequence of its three rows."""

ZERO: tuple[float, float, float] = (0.0, 0.0, 0.0)


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


def inner(a: Vector, b: Vector) -> float:
    """Return a . b."""
    ax, ay, az = a
    bx, by, bz = b
    return ax * bx + ay * by + az * bz


def apply(A: Sequence[Vector], x: Vector) -> tuple[float, float, float]:
    """Return A x of a (3, 3) matrix."""
    (a, b, c), (d, e, f), (g, h, i) = A
    x1, x2, x3 = x
    return a * x1 + b * x2 + c * x3, d * x1 + e * x2 + f * x3, g * x1 + h * x2 + i * x3


def apply_transposed(A: Sequence[Vector], x: Vector) -> tuple[float, float, float]:
    """Return A^T x of a (3, 3) matrix: of a rotation, the way back."""
    (a, b, c), (d, e, f), (g, h, i) = A
    x1, x2, x3 = x
    return a * x1 + d * x2 + g * x3, b * x1 + e * x2 + h * x3, c * x1 + f * x2 + i * x3
