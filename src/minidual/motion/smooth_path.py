"""A curve of polynomial pieces of fourth degree, and how it is driven."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numba.core import types

from minidual.robot.compiled import BLOCKS, ROWS, VECTOR, floats, kernel
from minidual.robot.constants import DOF, Array

_TERMS = 5
_WIDTH = 16
"""Columns that a row is given: the 14 joints, and two more because computers count in powers of two."""


@dataclass(frozen=True, eq=False)
class SmoothPath:
    """A curve q(s), (d,), s in [0, length]; for joints d = 14 and q is in [rad].

    Attributes:
        coefficients: (5, m, d): piece i is the sum of coefficients[4 - k, i] (s - knots[i])^k.
        knots: (m + 1,) where the pieces meet, first 0.
    """

    coefficients: Array
    knots: Array

    @property
    def length(self) -> float:
        """Length of the parameter interval, of a curve of joints in [rad]."""
        return float(self.knots[-1])

    def at(self, s: Array, order: int = 0) -> Array:
        """Return q or a derivative by s at (n,) parameters, (n, d)."""
        return _evaluate(self.coefficients, self.knots, floats(s), order)

    def driven(self, s: Array, speed: Array, acceleration: Array) -> tuple[Array, Array, Array]:
        """Return q, dq/dt and d2q/dt2, each (n, 14), where s, ds/dt and d2s/dt2 are known, each (n,).

        Raises:
            ValueError: Other shapes, or a curve that is not of 14 joints.
        """
        if self.coefficients.shape[2] != DOF or not len(s) == len(speed) == len(acceleration):
            raise ValueError(
                f"a curve of {self.coefficients.shape[2]} columns cannot be driven at {len(s)} parameters with "
                f"{len(speed)} speeds and {len(acceleration)} accelerations"
            )
        q, v, a = (np.empty((len(s), DOF)) for _ in range(3))
        _drive(self.coefficients, self.knots, floats(s), floats(speed), floats(acceleration), q, v, a)
        return q, v, a


@njit
def _piece(knots: Array, s: float, i: int) -> int:
    """Return the piece in which s lies, looked for from piece i on; beyond the ends the outermost piece goes on."""
    while i < len(knots) - 2 and s >= knots[i + 1]:
        i += 1
    while i > 0 and s < knots[i]:
        i -= 1
    return i


@kernel(ROWS(BLOCKS, VECTOR, VECTOR, types.int64))
def _evaluate(coefficients: Array, knots: Array, s: Array, order: int) -> Array:
    """Return the curve or a derivative at parameters (n,) in any order, (n, d)."""
    d = coefficients.shape[2]
    out = np.zeros((len(s), d))
    i = 0
    for k in range(len(s)):
        i = _piece(knots, s[k], i)
        x = s[k] - knots[i]
        power = 1.0 + 0.0 * x  # 1, but NaN stays NaN
        for exponent in range(order, _TERMS):
            factor = 1.0
            for f in range(exponent - order + 1, exponent + 1):
                factor *= f
            for j in range(d):
                out[k, j] += coefficients[_TERMS - 1 - exponent, i, j] * power * factor
            power *= x
    return out


@njit
def _row(piece: Array, x: float, speed: float, acceleration: float, out: Array) -> None:
    """Fill a row of q, v and a, side by side, x behind the start of a piece."""
    xx = x * x
    xxx = xx * x
    xxxx = xxx * x
    faster = speed * speed
    for j in range(_WIDTH):
        c4, c3, c2 = piece[j], piece[_WIDTH + j], piece[2 * _WIDTH + j]
        c1, c0 = piece[3 * _WIDTH + j], piece[4 * _WIDTH + j]
        first = c1 + c2 * x * 2.0 + c3 * xx * 3.0 + c4 * xxx * 4.0
        second = c2 * 2.0 + c3 * x * 6.0 + c4 * xx * 12.0
        out[j] = c0 + c1 * x + c2 * xx + c3 * xxx + c4 * xxxx
        out[_WIDTH + j] = first * speed
        out[2 * _WIDTH + j] = second * faster + first * acceleration


@kernel(types.void(BLOCKS, VECTOR, VECTOR, VECTOR, VECTOR, ROWS, ROWS, ROWS))
def _drive(
    coefficients: Array, knots: Array, s: Array, speed: Array, acceleration: Array, q: Array, v: Array, a: Array
) -> None:
    """Fill q, v and a (n, 14) of a curve of 14 columns."""
    work = np.zeros((_TERMS + 3) * _WIDTH)
    piece, row = work[: _TERMS * _WIDTH], work[_TERMS * _WIDTH :]
    i, filled = 0, -1
    for k in range(len(s)):
        i = _piece(knots, s[k], i)
        if i != filled:
            for term in range(_TERMS):
                for j in range(DOF):
                    piece[term * _WIDTH + j] = coefficients[term, i, j]
            filled = i
        _row(piece, s[k] - knots[i], speed[k], acceleration[k], row)
        for j in range(DOF):
            q[k, j], v[k, j], a[k, j] = row[j], row[_WIDTH + j], row[2 * _WIDTH + j]
