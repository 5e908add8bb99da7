"""Rounding of a polyline's corners.

In a corner of half length d, q' = u1 + (u2 - u1) S(x), x = (s - s0) / 2d, S(x) = 3 x^2 - 2 x^3. S
is symmetric, so the corner meets both straight pieces, twice continuously differentiable.
"""

import math
from typing import NamedTuple

import numpy as np

from minidual.motion.search import EdgeChecker
from minidual.robot.compiled import BLOCKS, ROWS, VECTOR, floats, kernel
from minidual.robot.pair import Array

_SHRINK = 0.5
_D_MIN_RAD = 1e-3
_OF_SEGMENT = 0.45


class SmoothPath(NamedTuple):
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
        factors = np.array([math.perm(k, order) for k in range(4, order - 1, -1)], dtype=float)
        return _evaluated(floats(self.coefficients), floats(self.knots), floats(s), factors)


@kernel(ROWS(BLOCKS, VECTOR, VECTOR, VECTOR), heap=True)
def _evaluated(coefficients: Array, knots: Array, s: Array, factors: Array) -> Array:
    """Return `SmoothPath.at` (n, d): a third of numpy's time."""
    out = np.zeros((len(s), coefficients.shape[2]))
    piece = 0
    for i in range(len(s)):
        while piece + 2 < len(knots) and s[i] >= knots[piece + 1]:
            piece += 1
        while piece > 0 and s[i] < knots[piece]:
            piece -= 1
        x = s[i] - knots[piece]
        for k in range(len(factors)):
            for j in range(out.shape[1]):
                out[i, j] = out[i, j] * x + factors[k] * coefficients[k, piece, j]
    return out


class _Polyline(NamedTuple):
    """A polyline and the size of its corners.

    Attributes:
        vertices: (n, d).
        lengths: Of the segments (n - 1,).
        directions: Unit vectors (n - 1, d).
        halves: Half lengths of the corners (n - 2,).
    """

    vertices: Array
    lengths: Array
    directions: Array
    halves: Array


def blended_path(
    path: Array,
    checker: EdgeChecker,
    radius_rad: float,
    step_rad: float,
) -> SmoothPath | None:
    """Return the polyline (n >= 2, dof) with corners rounded, shrunk until free.

    None if a corner stays blocked. Vertices must not repeat. `radius_rad` is the largest half
    length of a corner, `step_rad` the step of its check.
    """
    polyline = _with_corners(path, radius_rad)
    halves = polyline.halves
    for i in range(len(halves)):
        while not checker.all_free(_corner_states(polyline, i, step_rad)):
            halves[i] *= _SHRINK
            if halves[i] < _D_MIN_RAD:
                return None
    return _assemble(polyline)


def rounded(path: Array, radius: float) -> SmoothPath:
    """Return the polyline (n, d) with rounded corners, unchecked."""
    return _assemble(_with_corners(path, radius))


def _with_corners(path: Array, radius: float) -> _Polyline:
    steps = np.diff(path, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    directions = steps / lengths[:, None]
    halves = np.minimum(radius, _OF_SEGMENT * np.minimum(lengths[:-1], lengths[1:]))
    return _Polyline(path, lengths, directions, halves)


def _corner_states(polyline: _Polyline, i: int, step_rad: float) -> Array:
    """Return the states (m, d) inside corner i, at most `step_rad` apart."""
    vertex = polyline.vertices[i + 1]
    u1 = polyline.directions[i]
    u2 = polyline.directions[i + 1]
    d = polyline.halves[i]
    count = max(2, int(np.ceil(2.0 * d / step_rad)))
    x = np.linspace(0.0, 1.0, count + 1)[1:-1, None]
    return vertex - d * u1 + 2.0 * d * (u1 * x + (u2 - u1) * (x**3 - 0.5 * x**4))


def _assemble(polyline: _Polyline) -> SmoothPath:
    """Return the curve: straight pieces at even indices, corners at odd ones."""
    vertices = polyline.vertices
    lengths = polyline.lengths
    directions = polyline.directions
    halves = polyline.halves
    pieces = np.zeros((5, 2 * len(lengths) - 1, vertices.shape[1]))
    widths = np.empty(pieces.shape[1])
    before = np.append(0.0, halves)
    after = np.append(halves, 0.0)
    widths[::2] = lengths - before - after
    widths[1::2] = 2.0 * halves
    d = halves[:, None]
    turns = np.diff(directions, axis=0)
    pieces[4, ::2] = vertices[:-1] + before[:, None] * directions
    pieces[4, 1::2] = vertices[1:-1] - d * directions[:-1]
    pieces[3, ::2] = directions
    pieces[3, 1::2] = directions[:-1]
    # Integral of q' = u + turn (3 x^2 - 2 x^3), x = t / 2d.
    pieces[1, 1::2] = turns / (4.0 * d**2)
    pieces[0, 1::2] = -turns / (16.0 * d**3)
    return SmoothPath(pieces, np.append(0.0, np.cumsum(widths)))
