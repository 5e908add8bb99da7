"""Shortcutting of polylines."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from minidual.motion.edges import EdgeChecker
from minidual.robot.pair import SIDES, Array


def path_length(path: Array) -> float:
    """Return the Euclidean length of a polyline (n, d) [rad]."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def shortcut(path: Array, checker: EdgeChecker, rng: np.random.Generator, rounds_n: int) -> Array:
    """Return a shorter free polyline (m, dof) after `rounds_n` random trials.

    Every other round moves one arm alone, as detours may differ in time.
    """
    path = path[kept_vertices(path, checker.edge_free)]
    whole, *arms = (checker.robot.groups[name] for name in ("both_arms", *(f"{side}_arm" for side in SIDES)))
    both_move = all(np.ptp(path[:, arm], axis=0).max() > 0.0 for arm in arms)
    parts = [whole, arms[0], whole, arms[1]] if both_move else [whole]
    for k in range(rounds_n):
        if len(path) < 3:
            break
        path = _cut_stretch(path, checker, rng, parts[k % len(parts)])
    return path[kept_vertices(path, checker.edge_free)]


def kept_vertices(path: Array, edge_free: Callable[[Array, Array], bool]) -> list[int]:
    """Return the rows of a path that remain when each vertex is joined to the farthest one it reaches."""
    kept, last = [0], len(path) - 1
    while kept[-1] < last:
        here, ahead = kept[-1], last
        while ahead > here + 1 and not edge_free(path[here], path[ahead]):
            ahead -= 1
        kept.append(ahead)
    return kept


def _cut_stretch(path: Array, checker: EdgeChecker, rng: np.random.Generator, joints: slice) -> Array:
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    marks = np.concatenate([[0.0], np.cumsum(lengths)])
    if marks[-1] == 0.0:
        return path[[0, -1]]
    s0, s1 = np.sort(rng.uniform(0.0, marks[-1], 2))
    i0, i1 = (int(np.searchsorted(marks, s, side="right")) - 1 for s in (s0, s1))
    i1 = min(i1, len(lengths) - 1)
    if i0 == i1:
        return path
    a = path[i0] + (s0 - marks[i0]) / lengths[i0] * (path[i0 + 1] - path[i0])
    b = path[i1] + (s1 - marks[i1]) / lengths[i1] * (path[i1 + 1] - path[i1])
    inner = path[i0 + 1 : i1 + 1]
    stretch = np.array([a, b])
    if joints != checker.robot.groups["both_arms"]:
        # The other arm keeps its motion at the same fractions.
        stretch = np.vstack([a, inner, b])
        fractions = (np.concatenate([[s0], marks[i0 + 1 : i1 + 1], [s1]]) - s0) / (s1 - s0)
        stretch[:, joints] = a[joints] + fractions[:, None] * (b - a)[joints]
    candidate = np.vstack([path[: i0 + 1], stretch, path[i1 + 1 :]])
    candidate = candidate[np.concatenate([[True], np.abs(np.diff(candidate, axis=0)).max(axis=1) > 1e-9])]
    if path_length(candidate) > marks[-1] - 1e-6:
        return path
    return candidate if all(checker.edge_free(p, r) for p, r in pairwise(stretch)) else path
