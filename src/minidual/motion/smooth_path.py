"""Piecewise quartic curve."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from minidual.robot.pair import Array

_TERMS = 5


@dataclass(frozen=True, eq=False)
class SmoothPath:
    """Curve q(s), (d,), s in [0, length].

    Attributes:
        coefficients: (5, m, d); piece i is the sum of coefficients[4 - k, i] (s - knots[i])^k.
        knots: Piece ends (m + 1,), first 0.
    """

    coefficients: Array
    knots: Array

    @property
    def length(self) -> float:
        """Length of the parameter interval."""
        return float(self.knots[-1])

    def at(self, s: Array, order: int = 0) -> Array:
        """Return q or a derivative at s (n,); the end pieces extrapolate."""
        piece = np.clip(np.searchsorted(self.knots, s, side="right") - 1, 0, len(self.knots) - 2)
        x = s - self.knots[piece]
        powers = np.empty((_TERMS - order, len(x)))
        powers[0] = 1.0 + 0.0 * x  # propagates NaN in s
        for k in range(1, len(powers)):
            powers[k] = powers[k - 1] * x
        factors = np.array([math.perm(k, order) for k in range(order, _TERMS)], dtype=float)
        terms = factors[:, None, None] * self.coefficients[::-1][order:]
        out = np.empty((len(x), terms.shape[2]))
        for k in range(terms.shape[1]):
            rows = np.flatnonzero(piece == k)
            if len(rows):
                together = rows[-1] - rows[0] == len(rows) - 1
                at = slice(rows[0], rows[-1] + 1) if together else rows
                out[at] = powers[:, at].T @ terms[:, k]
        return out
