"""Shortcutting of polylines."""

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from minidual.motion.search import EdgeChecker
from minidual.robot.kinematics import path_length
from minidual.robot.pair import SIDES, Array

_SAME_RAD = 1e-9
_GAIN_MIN_RAD = 1e-6


class Stretch(NamedTuple):
    """Two places on a polyline (n, d).

    Attributes:
        marks: Length from the start to each vertex (n,).
        first_s, last_s: Lengths from the start to both places.
        first_segment, last_segment: Their segments.
        ends: Their points (2, d).
    """

    marks: Array
    first_s: float
    last_s: float
    first_segment: int
    last_segment: int
    ends: Array


def shortcut(path: Array, checker: EdgeChecker, rng: np.random.Generator, rounds_n: int) -> Array:
    """Return a shorter free polyline (m, dof) after `rounds_n` random trials.

    Every other round moves one arm alone, as detours may differ in time.
    """
    path = path[kept_vertices(path, checker.edge_free)]
    groups = checker.robot.groups
    whole = groups["both_arms"]
    left, right = (groups[f"{side}_arm"] for side in SIDES)
    both_move = all(np.ptp(path[:, arm], axis=0).max() > 0.0 for arm in (left, right))
    parts = [whole, left, whole, right] if both_move else [whole]
    for k in range(rounds_n):
        if len(path) < 3:
            break
        path = _cut_stretch(path, checker, rng, parts[k % len(parts)])
    return path[kept_vertices(path, checker.edge_free)]


def kept_vertices(path: Array, edge_free: Callable[[Array, Array], bool]) -> list[int]:
    """Return the rows of a path that remain if each joins the farthest one that it reaches."""
    kept = [0]
    last = len(path) - 1
    while kept[-1] < last:
        here = kept[-1]
        ahead = last
        while ahead > here + 1 and not edge_free(path[here], path[ahead]):
            ahead -= 1
        kept.append(ahead)
    return kept


def random_stretch(path: Array, lengths: Array, rng: np.random.Generator) -> Stretch:
    """Return two random places on a path (n, d) with segments of these lengths (n - 1,)."""
    marks = np.concatenate([[0.0], np.cumsum(lengths)])
    s = np.sort(rng.uniform(0.0, marks[-1], 2))
    segments = np.minimum(marks.searchsorted(s, side="right") - 1, len(lengths) - 1)
    shares = (s - marks[segments]) / lengths[segments]
    ends = path[segments] + shares[:, None] * (path[segments + 1] - path[segments])
    return Stretch(marks, s[0], s[1], int(segments[0]), int(segments[1]), ends)


def _cut_stretch(
    path: Array,
    checker: EdgeChecker,
    rng: np.random.Generator,
    joints: slice,
) -> Array:
    """Return the path with a random stretch of `joints` made straight, if that is free."""
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    if not lengths.any():
        return path[[0, -1]]
    stretch = random_stretch(path, lengths, rng)
    first = stretch.first_segment
    last = stretch.last_segment
    if first == last:
        return path
    whole = joints == checker.robot.groups["both_arms"]
    straight = stretch.ends if whole else _straight_joints(path, stretch, joints)
    candidate = np.concatenate([path[: first + 1], straight, path[last + 1 :]])
    steps = np.abs(np.diff(candidate, axis=0)).max(axis=1)
    candidate = candidate[np.concatenate([[True], steps > _SAME_RAD])]
    if path_length(candidate) > stretch.marks[-1] - _GAIN_MIN_RAD:
        return path
    if all(checker.edge_free(a, b) for a, b in pairwise(straight)):
        return candidate
    return path


def _straight_joints(path: Array, stretch: Stretch, joints: slice) -> Array:
    """Return the stretch (m, dof) with `joints` on a line; the others keep their motion."""
    a, b = stretch.ends
    inside = slice(stretch.first_segment + 1, stretch.last_segment + 1)
    points = np.vstack([a, path[inside], b])
    marks = np.concatenate([[stretch.first_s], stretch.marks[inside], [stretch.last_s]])
    fractions = (marks - stretch.first_s) / (stretch.last_s - stretch.first_s)
    points[:, joints] = a[joints] + fractions[:, None] * (b - a)[joints]
    return points
