"""Search over object poses; both hands follow by IK.

A point z (6 + n,) holds `ObjectChart` coordinates and joints. Edges interpolate both and project the joints onto the
grasps: they depend only on their ends.

Sources: RRT-Connect (Kuffner and LaValle, ICRA 2000); leader-follower after Han and Amato, "A kinematics-based
probabilistic roadmap method for closed chain systems", 2000.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from minidual.motion.blend import kept_vertices, random_stretch
from minidual.motion.held.hands import HandsIK
from minidual.motion.held.path import ObjectChart
from minidual.motion.search import EdgeChecker, bisection_order
from minidual.robot.pair import Array

X = slice(0, 6)
Q = slice(6, None)
JOINT_WEIGHT_M = 0.1
"""Distance per radian of joint motion [m/rad]."""
_STEP_M = 0.03
_STEP_RAD = 0.06
_JUMP_RAD = 0.4
_SURE_RAD = 0.12
_HALVED = 0.75
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


class HeldSpace:
    """Points and edges; `step_scale` scales the check steps."""

    def __init__(
        self,
        hands: HandsIK,
        chart: ObjectChart,
        checker: EdgeChecker,
        step_scale: float = 1.0,
    ) -> None:
        self._step_m = step_scale * _STEP_M
        self._step_rad = step_scale * _STEP_RAD
        self._jump_rad = step_scale * _JUMP_RAD
        self.hands = hands
        self.chart = chart
        self.checker = checker

    def point(self, T_world_object: Array, q: Array) -> Array:
        """Return (6 + n,)."""
        return np.concatenate([self.chart.coordinates(T_world_object), q])

    def solved_free(self, z: Array) -> Array | None:
        """Return z with projected joints, None unless free."""
        q = self.hands.solve(self.chart.pose(z[X]), z[Q])
        return np.concatenate([z[X], q]) if q is not None and self.checker.free(q) else None

    @staticmethod
    def distance(z: Array, Z: Array) -> Array:
        """Return distances [m] to Z (m, 6 + n)."""
        d = Z - z
        return np.linalg.norm(d[:, X], axis=1) + JOINT_WEIGHT_M * np.linalg.norm(d[:, Q], axis=1)

    def edge_free(self, a: Array, b: Array) -> bool:
        """Return whether an edge is continuous, and free between its ends."""
        step = b - a
        steps = np.linalg.norm(step[X]) / self._step_m, np.abs(step[Q]).max() / self._step_rad
        count = max(1, int(np.ceil(max(steps))))
        joints = np.empty((count + 1, len(step) - 6))
        joints[0], joints[-1] = a[Q], b[Q]
        for share in bisection_order(count)[1:]:  # the first is b
            if (z := self.solved_free(a + share * step)) is None:
                return False
            joints[round(share * count)] = z[Q]
        jumps = np.abs(np.diff(joints, axis=0)).max(axis=1)
        if jumps.max() > self._jump_rad:
            return False
        # A large joint step is fast motion (halving the interval halves it) or a change of IK branch.
        return all(
            self._continuous(a, step, k / count, (k + 1) / count, joints[k], joints[k + 1])
            for k in np.flatnonzero(jumps > _SURE_RAD)
        )

    def _continuous(
        self,
        a: Array,
        step: Array,
        u: float,
        v: float,
        q_u: Array,
        q_v: Array,
    ) -> bool:
        """Halve a joint step between shares u and v until it is small; False if it stays large."""
        jump = float(np.abs(q_v - q_u).max())
        if jump <= _SURE_RAD:
            return True
        middle = 0.5 * (u + v)
        z = self.solved_free(a + middle * step)
        if z is None or max(np.abs(z[Q] - q_u).max(), np.abs(q_v - z[Q]).max()) > _HALVED * jump:
            return False
        return self._continuous(a, step, u, middle, q_u, z[Q]) and self._continuous(
            a,
            step,
            middle,
            v,
            z[Q],
            q_v,
        )

    @staticmethod
    def sample(rng: np.random.Generator, ends: Array, room_m: float, turn_m: float) -> Array:
        """Return random coordinates (6,) around both ends (2, 6)."""
        low = ends[:, :3].min(axis=0) - room_m
        high = ends[:, :3].max(axis=0) + room_m
        low[2] = max(low[2], 0.0)
        between = ends[0, 3:] + rng.uniform() * (ends[1, 3:] - ends[0, 3:])
        return np.concatenate([rng.uniform(low, high), between + rng.uniform(-turn_m, turn_m, 3)])


class _Tree:
    def __init__(self, roots: Sequence[Array]) -> None:
        self.points = np.array(roots, dtype=float)
        self.parents = [-1] * len(roots)

    def near_object(self, x: Array, rng: np.random.Generator, among: int) -> int:
        """Return one of the `among` nearest points."""
        away = np.linalg.norm(self.points[:, X] - x, axis=1)
        return (
            int(np.argmin(away))
            if among == 1
            else int(rng.choice(np.argsort(away, kind="stable")[:among]))
        )

    def add(self, z: Array, parent: int) -> int:
        self.points = np.vstack([self.points, z])
        self.parents.append(parent)
        return len(self.parents) - 1

    def branch(self, index: int) -> list[Array]:
        points = []
        while index >= 0:
            points.append(self.points[index])
            index = self.parents[index]
        return points[::-1]


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
    here = _Tree([start])
    there = _Tree(goals)
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
            arrived = _carry_to(space, here, ends[1], rng)
            if arrived is not None:
                return np.array(here.branch(arrived))
        x = space.sample(rng, ends, room, _TURN_M)
        swing = rng.random() < _ELBOW_SHARE
        # Growing only the nearest point would not spread the elbows.
        parent = here.near_object(x, rng, _NEXT_N if swing else 1)
        if (
            new := _step_towards(space, here.points[parent], x, rng if swing else None)
        ) is not None:
            met = _connect(space, there, new)
            grown = here.add(new, parent)
            if met is not None:
                path = here.branch(grown) + there.branch(met)[::-1][1:]
                return np.array(path if forward else path[::-1])
        here, there, forward = there, here, not forward
    return None


def _step_towards(
    space: HeldSpace,
    z: Array,
    x: Array,
    elbows: np.random.Generator | None,
) -> Array | None:
    way = x - z[X]
    share = min(1.0, _EXTEND_M / max(float(np.linalg.norm(way)), _SAME_M))
    aim = z.copy()
    aim[X] = x if share == 1.0 else z[X] + share * way
    aim[Q] += _EXTEND_M * space.hands.off_limits(z[Q])
    if elbows is not None:
        aim[Q] += space.hands.elbow_swing(z[Q], elbows.uniform(-_ELBOW_RAD, _ELBOW_RAD, 2))
    new = space.solved_free(aim)
    return new if new is not None and space.edge_free(z, new) else None


def _carry_to(space: HeldSpace, tree: _Tree, x: Array, rng: np.random.Generator) -> int | None:
    current = tree.near_object(x, rng, _NEXT_N)
    while True:
        if (new := _step_towards(space, tree.points[current], x, None)) is None:
            return None
        current = tree.add(new, current)
        if np.array_equal(new[X], x):
            return current


def _connect(space: HeldSpace, tree: _Tree, z: Array) -> int | None:
    current = int(np.argmin(space.distance(z, tree.points)))
    while True:
        away = float(space.distance(z, tree.points[current][None])[0])
        share = min(1.0, _CONNECT_M / max(away, _SAME_M))
        point = tree.points[current]
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
        lengths = np.array(
            [float(space.distance(a, b[None])[0]) for a, b in itertools.pairwise(points)],
        )
        _, _, (i, j), ends = random_stretch(points, lengths, rng)
        if i == j:
            continue
        a, b = map(space.solved_free, ends)
        if a is None or b is None:
            continue
        before = float(lengths[i : j + 1].sum())
        pieces = (points[i], a, b, points[j + 1])
        after = sum(float(space.distance(p, r[None])[0]) for p, r in itertools.pairwise(pieces))
        if after <= 0.99 * before and all(
            space.edge_free(p, r) for p, r in ((a, b), (points[i], a), (b, points[j + 1]))
        ):
            points = np.vstack([points[: i + 1], a, b, points[j + 1 :]])
    return points
