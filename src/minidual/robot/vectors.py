"""Vectors of three floats: `np.cross` takes 14 us, `cross` 0.13 us."""

from collections.abc import Sequence

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
