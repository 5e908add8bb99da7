"""Search over object poses; both hands follow by IK.

Sources: RRT-Connect (Kuffner and LaValle, ICRA 2000); leader-follower after Han and Amato, "A
kinematics-based probabilistic roadmap method for closed chain systems", 2000.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from minidual.motion.held.space import HeldSpace, Q, X
from minidual.motion.shortcut import kept_vertices, random_stretch
from minidual.robot.pair import Array

_EXTEND_M = 0.15
_CONNECT_M = 0.25
_ELBOW_SHARE = 0.5
_ELBOW_RAD = 0.6
_GOAL_SHARE = 0.3
_NEXT_N = 8
_SAME_M = 1e-9
_ROOM_START_M = 0.08
_ROOM_GROWTH_M = 0.02
_ROOM_MAX_M = 0.35
_TURN_M = 0.12
_SHORTER = 0.99


class _Tree:
    """Points (k, 6 + n) and the row of each one's parent; -1 for roots."""

    def __init__(self, roots: Sequence[Array]) -> None:
        self.points = np.array(roots, dtype=float)
        self.parents = [-1] * len(roots)

    def near_object(self, x: Array, rng: np.random.Generator, among: int) -> int:
        """Return one of the `among` points nearest to x (6,)."""
        away = np.linalg.norm(self.points[:, X] - x, axis=1)
        if among == 1:
            return int(np.argmin(away))
        return int(rng.choice(np.argsort(away, kind="stable")[:among]))

    def add(self, z: Array, parent: int) -> int:
        """Add a point (6 + n,); return its row."""
        self.points = np.vstack([self.points, z])
        self.parents.append(parent)
        return len(self.parents) - 1

    def branch(self, index: int) -> list[Array]:
        """Return the points from a root to a row."""
        points: list[Array] = []
        while index >= 0:
            points.append(self.points[index])
            index = self.parents[index]
        points.reverse()
        return points


def search_object(
    space: HeldSpace,
    start: Array,
    goals: Sequence[Array],
    rng: np.random.Generator,
    *,
    any_posture: bool = True,
) -> Array | None:
    """Return free points (m, 6 + n) from the start to a goal, joined by free edges, or None.

    All goals (6 + n,) have one object pose; `any_posture` accepts other joints there.
    """
    tree = _Tree([start])
    other_tree = _Tree(goals)
    ends = np.array([start[X], goals[0][X]])
    forward = True
    rounds = 0
    for goal in goals:
        if space.edge_free(start, goal):
            return np.array([start, goal])
    while not space.checker.spent:
        # The sampling box grows with time.
        room = min(_ROOM_START_M + _ROOM_GROWTH_M * rounds, _ROOM_MAX_M)
        rounds += 1
        if forward and any_posture and rng.random() < _GOAL_SHARE:
            arrived = _carry_to(space, tree, ends[1], rng)
            if arrived is not None:
                return np.array(tree.branch(arrived))
        x = space.sample(rng, ends, room, _TURN_M)
        grown = _grow(space, tree, x, rng)
        if grown is not None:
            joined_row = _connect(space, other_tree, tree.points[grown])
            if joined_row is not None:
                return _joined(tree.branch(grown), other_tree.branch(joined_row), forward)
        tree, other_tree = other_tree, tree
        forward = not forward
    return None


def _grow(space: HeldSpace, tree: _Tree, x: Array, rng: np.random.Generator) -> int | None:
    """Add a point towards x (6,); return its row, or None if it is blocked."""
    swing = rng.random() < _ELBOW_SHARE
    # Growing only the nearest point would not spread the elbows.
    parent = tree.near_object(x, rng, _NEXT_N if swing else 1)
    new = _step_towards(space, tree.points[parent], x, rng if swing else None)
    if new is None:
        return None
    return tree.add(new, parent)


def _joined(branch: list[Array], other: list[Array], forward: bool) -> Array:
    """Return the path (m, 6 + n) over two branches that end at the same point."""
    path = branch + list(reversed(other[:-1]))
    if not forward:
        path.reverse()
    return np.array(path)


def _step_towards(
    space: HeldSpace,
    z: Array,
    x: Array,
    elbows: np.random.Generator | None,
) -> Array | None:
    """Return a point (6 + n,) from z towards x (6,), or None; `elbows` draws elbow swings."""
    way = x - z[X]
    share = min(1.0, _EXTEND_M / max(float(np.linalg.norm(way)), _SAME_M))
    aim = z.copy()
    aim[X] = x if share == 1.0 else z[X] + share * way
    aim[Q] += _EXTEND_M * space.hands.off_limits(z[Q])
    if elbows is not None:
        aim[Q] += space.hands.elbow_swing(z[Q], elbows.uniform(-_ELBOW_RAD, _ELBOW_RAD, 2))
    new = space.solved_free(aim)
    if new is None or not space.edge_free(z, new):
        return None
    return new


def _carry_to(space: HeldSpace, tree: _Tree, x: Array, rng: np.random.Generator) -> int | None:
    """Grow a branch to x (6,); return the row there, or None if it is blocked."""
    current = tree.near_object(x, rng, _NEXT_N)
    while True:
        new = _step_towards(space, tree.points[current], x, None)
        if new is None:
            return None
        current = tree.add(new, current)
        if np.array_equal(new[X], x):
            return current


def _connect(space: HeldSpace, tree: _Tree, z: Array) -> int | None:
    """Grow a branch to z (6 + n,); return the row there, or None if it is blocked."""
    current = int(np.argmin(space.distance(z, tree.points)))
    while True:
        point = tree.points[current]
        share = min(1.0, _CONNECT_M / max(space.length(z, point), _SAME_M))
        step = z if share == 1.0 else space.solved_free(point + share * (z - point))
        if step is None or not space.edge_free(point, step):
            return None
        current = tree.add(step, current)
        if share == 1.0:
            return current


def shorten(space: HeldSpace, path: Array, rng: np.random.Generator, rounds_n: int) -> Array:
    """Return a shorter path (m, 6 + n)."""
    points = path[kept_vertices(path, space.edge_free)]
    for _ in range(rounds_n):
        if len(points) < 3:
            break
        points = _cut_stretch(space, points, rng)
    return points


def _cut_stretch(space: HeldSpace, points: Array, rng: np.random.Generator) -> Array:
    """Return the points with a random stretch made straight, if that is free and shorter."""
    lengths = np.array([space.length(a, b) for a, b in itertools.pairwise(points)])
    stretch = random_stretch(points, lengths, rng)
    first = stretch.first_segment
    last = stretch.last_segment
    if first == last:
        return points
    a = space.solved_free(stretch.ends[0])
    b = space.solved_free(stretch.ends[1])
    if a is None or b is None:
        return points
    entry = points[first]
    leave = points[last + 1]
    before = float(lengths[first : last + 1].sum())
    after = sum(space.length(p, r) for p, r in itertools.pairwise((entry, a, b, leave)))
    if after > _SHORTER * before:
        return points
    if all(space.edge_free(p, r) for p, r in ((a, b), (entry, a), (b, leave))):
        return np.vstack([points[: first + 1], a, b, points[last + 1 :]])
    return points
