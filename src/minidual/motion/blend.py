"""Shortcutting of polylines and rounding of their corners.

In a corner of half length d, q' = u1 + (u2 - u1) S(x), x = (s - s0) / 2d, S(x) = 3 x^2 - 2 x^3. S is symmetric, so the
corner meets both straight pieces, twice continuously differentiable.
"""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from minidual.motion.search import EdgeChecker
from minidual.robot.compiled import BLOCKS, ROWS, VECTOR, floats, kernel
from minidual.robot.kinematics import path_length
from minidual.robot.pair import SIDES, Array


def shortcut(path: Array, checker: EdgeChecker, rng: np.random.Generator, rounds_n: int) -> Array:
    """Return a shorter free polyline (m, dof) after `rounds_n` random trials.

    Every other round moves one arm alone, as detours may differ in time.
    """
    path = path[kept_vertices(path, checker.edge_free)]
    whole, *arms = (
        checker.robot.groups[name] for name in ("both_arms", *(f"{side}_arm" for side in SIDES))
    )
    both_move = all(np.ptp(path[:, arm], axis=0).max() > 0.0 for arm in arms)
    parts = [whole, arms[0], whole, arms[1]] if both_move else [whole]
    for k in range(rounds_n):
        if len(path) < 3:
            break
        path = _cut_stretch(path, checker, rng, parts[k % len(parts)])
    return path[kept_vertices(path, checker.edge_free)]


def kept_vertices(path: Array, edge_free: Callable[[Array, Array], bool]) -> list[int]:
    """Return the rows of a path that remain when each vertex is joined to the farthest one it reaches."""
    kept = [0]
    last = len(path) - 1
    while kept[-1] < last:
        here = kept[-1]
        ahead = last
        while ahead > here + 1 and not edge_free(path[here], path[ahead]):
            ahead -= 1
        kept.append(ahead)
    return kept


def random_stretch(
    path: Array,
    length: Array,
    rng: np.random.Generator,
) -> tuple[Array, Array, tuple[int, int], Array]:
    """Return the marks (n,) along a path (n, d), and of two random places the marks, segments and points (2, d)."""
    marks = np.concatenate([[0.0], np.cumsum(length)])
    s = np.sort(rng.uniform(0.0, marks[-1], 2))
    at = np.minimum(marks.searchsorted(s, side="right") - 1, len(length) - 1)
    ends = path[at] + ((s - marks[at]) / length[at])[:, None] * (path[at + 1] - path[at])
    return marks, s, (int(at[0]), int(at[1])), ends


def _cut_stretch(
    path: Array,
    checker: EdgeChecker,
    rng: np.random.Generator,
    joints: slice,
) -> Array:
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    if not lengths.any():
        return path[[0, -1]]
    marks, (s0, s1), (i0, i1), stretch = random_stretch(path, lengths, rng)
    if i0 == i1:
        return path
    a, b = stretch
    if joints != checker.robot.groups["both_arms"]:
        # The other arm keeps its motion at the same fractions.
        stretch = np.vstack([a, path[i0 + 1 : i1 + 1], b])
        fractions = (np.concatenate([[s0], marks[i0 + 1 : i1 + 1], [s1]]) - s0) / (s1 - s0)
        stretch[:, joints] = a[joints] + fractions[:, None] * (b - a)[joints]
    candidate = np.concatenate([path[: i0 + 1], stretch, path[i1 + 1 :]])
    candidate = candidate[
        np.concatenate([[True], np.abs(np.diff(candidate, axis=0)).max(axis=1) > 1e-9])
    ]
    if path_length(candidate) > marks[-1] - 1e-6:
        return path
    return candidate if all(checker.edge_free(p, r) for p, r in pairwise(stretch)) else path


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


def blended_path(
    path: Array,
    checker: EdgeChecker,
    radius_rad: float,
    step_rad: float,
) -> SmoothPath | None:
    """Return the polyline (n >= 2, dof) with corners rounded, shrunk until free; None if one stays blocked.

    Vertices must not repeat. `radius_rad` is the largest half length of a corner.
    """
    lengths, directions, halves = _corners(path, radius_rad)
    for i in range(len(halves)):
        while not _corner_free(
            path[i + 1],
            directions[i],
            directions[i + 1],
            halves[i],
            checker,
            step_rad,
        ):
            halves[i] *= _SHRINK
            if halves[i] < _D_MIN_RAD:
                return None
    return _assemble(path, lengths, directions, halves)


def rounded(path: Array, radius: float) -> SmoothPath:
    """Return the polyline (n, d) with rounded corners, unchecked."""
    return _assemble(path, *_corners(path, radius))


def _corners(path: Array, radius: float) -> tuple[Array, Array, Array]:
    steps = np.diff(path, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    return (
        lengths,
        steps / lengths[:, None],
        np.minimum(radius, _OF_SEGMENT * np.minimum(lengths[:-1], lengths[1:])),
    )


def _corner_free(
    vertex: Array,
    u1: Array,
    u2: Array,
    d: float,
    checker: EdgeChecker,
    step_rad: float,
) -> bool:
    x = np.linspace(0.0, 1.0, max(2, int(np.ceil(2.0 * d / step_rad))) + 1)[1:-1, None]
    return checker.all_free(vertex - d * u1 + 2.0 * d * (u1 * x + (u2 - u1) * (x**3 - 0.5 * x**4)))


def _assemble(path: Array, lengths: Array, directions: Array, halves: Array) -> SmoothPath:
    pieces = np.zeros((5, 2 * len(lengths) - 1, path.shape[1]))
    widths = np.empty(pieces.shape[1])
    before = np.append(0.0, halves)
    after = np.append(halves, 0.0)
    widths[::2], widths[1::2] = lengths - before - after, 2.0 * halves
    d = halves[:, None]
    turns = np.diff(directions, axis=0)
    pieces[4, ::2] = path[:-1] + before[:, None] * directions
    pieces[4, 1::2] = path[1:-1] - d * directions[:-1]
    pieces[3, ::2], pieces[3, 1::2] = directions, directions[:-1]
    # Integral of q' = u + turn (3 x^2 - 2 x^3), x = t / 2d.
    pieces[1, 1::2] = turns / (4.0 * d**2)
    pieces[0, 1::2] = -turns / (16.0 * d**3)
    return SmoothPath(pieces, np.append(0.0, np.cumsum(widths)))
