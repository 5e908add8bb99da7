"""Vectors of three floats: `np.cross` takes 14 us, `cross` 0.13 us."""

from __future__ import annotations

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
