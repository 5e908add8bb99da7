"""Seeded planning queries around a table with obstacles, and stored sets of them.

IK solves poses over the table; no planner is used. A set holds one hundred hard queries per group,
for two seeds and the default robot. Each of these has a witness: corners of a polyline that both
engines find free every 0.002 rad. `python scripts/make_query_set.py SEED` makes a set.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from minidual.collision.engines import MujocoEngine
from minidual.collision.errors import PlanningError
from minidual.collision.scene import TABLE, PlanningScene
from minidual.collision.shapes import Box, Cylinder, Shape
from minidual.config.seeds import stored_stream
from minidual.errors import DataError
from minidual.motion.ik import solvers
from minidual.proof.scene_engines import STEP_RAD
from minidual.robot.pair import DUAL_PANDA, GROUP_ARMS, SIDES, Array, Robot, pose, rot_x, rot_z

OBSTACLES_N = 5
ROBOT = DUAL_PANDA
"""Of the stored sets."""
_ROOM_M = 0.01
_TILT_RAD = 0.6
_IK_STARTS_N = 6
_POSE_TRIES_N = 60
_STEP_RAD = 0.05
_SCENE_TRIES_N = 200
_PAIRS_TRIES_N = 8
_CROSSED_BY_M = 0.05
_BASE_CLEAR_M = 0.28


@dataclass(frozen=True, eq=False)
class Query:
    """A query.

    Attributes:
        q_start: Free (n,) [rad].
        q_goal: Free (n,) [rad]. For a goal of poses the plan may end in another IK solution of
            `targets`.
        kind: Why it is hard: the straight line runs into an obstacle ("past_obstacle") or the other
            arm ("past_arm"), or is blocked while the hands change sides ("crossing"); or "any".
        attempt: Number of the scene, see `scene_of`.
    """

    group: str
    index: int
    seed: int
    scene: PlanningScene
    q_start: Array
    q_goal: Array
    kind: str = "any"
    attempt: int = 0

    @property
    def as_poses(self) -> bool:
        """Whether the goal is given as poses; alternates in pairs."""
        return self.index % 4 >= 2

    @cached_property
    def targets(self) -> dict[str, Array]:
        """T_world_tcp (4, 4) of the group's arms at the goal."""
        return goal_targets(self.group, self.q_goal, self.scene.robot)


@dataclass(frozen=True)
class QueryGenerator:
    """Makes queries by seed, group and index; `blocked_fraction` of them are hard."""

    seed: int
    obstacles_n: int = OBSTACLES_N
    blocked_fraction: float = 1.0
    robot: Robot = DUAL_PANDA

    def kind(self, group: str, index: int) -> str:
        """Return the required kind of a query."""
        if int((index + 1) * self.blocked_fraction) == int(index * self.blocked_fraction):
            return "any"
        return self.kind_of(group, index)

    @staticmethod
    def kind_of(group: str, index: int) -> str:
        """Return the kind of a hard query."""
        if index % 2 == 0:
            return "past_obstacle"
        return "crossing" if group == "both_arms" else "past_arm"

    def query(self, group: str, index: int, first_attempt: int = 0) -> Query:
        """Return query `index`, skipping scenes before `first_attempt`.

        Raises:
            UsageError: Unknown group.
            PlanningError: None found.
        """
        for attempt in range(first_attempt, first_attempt + _SCENE_TRIES_N):
            query = self.attempt(group, index, attempt)
            if query is not None:
                return query
        raise PlanningError(
            f"no query {index} for {group} with {self.obstacles_n} obstacles"
            f" after {_SCENE_TRIES_N} scenes",
            remedy="use fewer obstacles or a smaller blocked_fraction",
        )

    def attempt(self, group: str, index: int, attempt: int) -> Query | None:
        """Return the query of one scene, or None."""
        arms = GROUP_ARMS[group]
        kind = self.kind(group, index)
        scene = scene_of(self.seed, group, index, attempt, self.obstacles_n, self.robot)
        rng = stored_stream(self.seed, _number(group), index, attempt, 1)
        engine = MujocoEngine(scene)
        crossing = kind == "crossing"
        crossed_at_goal = bool(rng.integers(2)) and crossing
        crossed_at_start = crossing and not crossed_at_goal
        for _ in range(_PAIRS_TRIES_N):
            start = self._configuration(rng, engine, self.robot.home, SIDES, crossed_at_start)
            if start is None:
                continue
            goal = self._configuration(rng, engine, start, arms, crossed_at_goal)
            if goal is None:
                continue
            if not _is_kind(kind, arms, _touched(engine, start, goal)):
                continue
            if crossing and not self._swaps_sides(group, start, goal):
                continue
            return Query(
                group=group,
                index=index,
                seed=int(rng.integers(2**31)),
                scene=scene,
                q_start=start,
                q_goal=goal,
                kind=kind,
                attempt=attempt,
            )
        return None

    def _configuration(
        self,
        rng: np.random.Generator,
        engine: MujocoEngine,
        q_base: Array,
        arms: tuple[str, ...],
        crossed: bool,
    ) -> Array | None:
        """Return a free posture with random poses of these arms, or None."""
        for _ in range(_POSE_TRIES_N):
            q = self._reach_all(rng, q_base, arms, crossed)
            if q is not None and not engine.closest(q, _ROOM_M):
                return q
        return None

    def _reach_all(
        self,
        rng: np.random.Generator,
        q_base: Array,
        arms: tuple[str, ...],
        crossed: bool,
    ) -> Array | None:
        """Return `q_base` with a random pose of each arm, or None; `crossed`: on the other side."""
        q = np.array(q_base)
        for arm in arms:
            T_world_tcp = random_pose(rng, arm)
            if crossed:
                other_side = -1.0 if arm == "left" else 1.0
                T_world_tcp[1, 3] = other_side * rng.uniform(0.03, 0.25)
            solution = self._reach(rng, arm, T_world_tcp)
            if solution is None:
                return None
            q[solvers(self.robot)[arm].joints] = solution
        return q

    def _reach(self, rng: np.random.Generator, arm: str, T_world_tcp: Array) -> Array | None:
        """Return an IK solution of one arm, from home or from random postures; None without one."""
        solver = solvers(self.robot)[arm]
        for attempt in range(_IK_STARTS_N):
            if attempt == 0:
                start = self.robot.home[solver.joints]
            else:
                start = rng.uniform(solver.lower, solver.upper)
            solution = solver.solve(T_world_tcp, start)
            if solution.reached:
                return solution.q
        return None

    def _swaps_sides(self, group: str, start: Array, goal: Array) -> bool:
        """Return whether the hands change sides between two postures."""
        before_m = _left_over_right_m(goal_targets(group, start, self.robot))
        after_m = _left_over_right_m(goal_targets(group, goal, self.robot))
        return before_m * after_m < 0.0 and min(abs(before_m), abs(after_m)) > _CROSSED_BY_M


def _number(group: str) -> int:
    """Return the number of a group in the random streams."""
    return list(DUAL_PANDA.groups).index(group)


def _touched(engine: MujocoEngine, start: Array, goal: Array) -> set[frozenset[str]]:
    """Return the pairs of parts that touch on the straight line between two postures."""
    pairs: set[frozenset[str]] = set()
    for q in polyline_states(np.array([start, goal]), _STEP_RAD)[1:-1]:
        pairs.update(engine.touching_pairs(q))
    return pairs


def goal_targets(group: str, q: Array, robot: Robot) -> dict[str, Array]:
    """Return T_world_tcp (4, 4) of the group's arms."""
    return {
        arm: solvers(robot)[arm].tcp_pose(q[robot.groups[f"{arm}_arm"]])
        for arm in GROUP_ARMS[group]
    }


def _left_over_right_m(targets: dict[str, Array]) -> float:
    """Return y of the left hand minus y of the right hand."""
    return targets["left"][1, 3] - targets["right"][1, 3]


def _is_kind(kind: str, arms: tuple[str, ...], touched: set[frozenset[str]]) -> bool:
    """Return whether the contacts on the straight line make a query one of a kind."""
    mine = tuple(f"{arm}_" for arm in arms)
    theirs = tuple(f"{arm}_" for arm in SIDES if arm not in arms)
    no_obstacle = ("left_", "right_", "table")
    mine_touched = [pair for pair in touched if any(name.startswith(mine) for name in pair)]
    if kind == "past_obstacle":
        return any(not name.startswith(no_obstacle) for pair in mine_touched for name in pair)
    if kind == "past_arm":
        return any(name.startswith(theirs) for pair in mine_touched for name in pair)
    return kind == "any" or bool(touched)


def scene_of(
    seed: int,
    group: str,
    index: int,
    attempt: int,
    obstacles_n: int,
    robot: Robot,
) -> PlanningScene:
    """Return the scene of one attempt."""
    rng = stored_stream(seed, _number(group), index, attempt, 0)
    return PlanningScene(obstacles=(TABLE, *random_obstacles(rng, obstacles_n, robot)), robot=robot)


def random_pose(rng: np.random.Generator, arm: str) -> Array:
    """Return a tcp pose (4, 4) over the table, hand down."""
    side = 1.0 if arm == "left" else -1.0
    position = np.array(
        [rng.uniform(0.30, 0.65), side * rng.uniform(-0.15, 0.55), rng.uniform(0.08, 0.45)],
    )
    yaw, lean_yaw = rng.uniform(-np.pi, np.pi, 2)
    lean = rot_z(lean_yaw) @ rot_x(rng.uniform(0.0, _TILT_RAD)) @ rot_z(-lean_yaw)
    return pose(lean @ rot_z(yaw) @ rot_x(np.pi), position)


def random_obstacles(
    rng: np.random.Generator,
    count: int,
    robot: Robot = DUAL_PANDA,
) -> tuple[Shape, ...]:
    """Return boxes and cylinders clear of the bases."""
    shapes: list[Shape] = []
    for number in range(count):
        height_m = float(rng.uniform(0.10, 0.40))
        x, y = _place_clear_of_bases(rng, robot)
        position_m = (round(x, 4), round(y, 4), round(0.5 * height_m, 4))
        if rng.random() < 0.5:
            length_m = round(float(rng.uniform(0.05, 0.16)), 4)
            width_m = round(float(rng.uniform(0.05, 0.16)), 4)
            half_yaw = 0.5 * float(rng.uniform(-np.pi / 2, np.pi / 2))
            quat = (float(np.cos(half_yaw)), 0.0, 0.0, float(np.sin(half_yaw)))
            size_m = (length_m, width_m, round(height_m, 4))
            shapes.append(Box(f"box{number}", position_m, quat, size_m))
        else:
            radius_m = round(float(rng.uniform(0.025, 0.07)), 4)
            cylinder = Cylinder(
                f"cylinder{number}",
                position_m,
                radius_m=radius_m,
                length_m=round(height_m, 4),
            )
            shapes.append(cylinder)
    return tuple(shapes)


def _place_clear_of_bases(rng: np.random.Generator, robot: Robot) -> tuple[float, float]:
    """Draw (x, y) [m] on the table until it is clear of both bases."""
    while True:
        x = float(rng.uniform(0.25, 0.75))
        y = float(rng.uniform(-0.60, 0.60))
        distances_m = [
            np.hypot(x - x_base, y - y_base) for x_base, y_base, _ in robot.base_positions_m
        ]
        if min(distances_m) > _BASE_CLEAR_M:
            return x, y


def query_source(
    seed: int,
    obstacles_n: int,
    blocked_fraction: float,
    robot: Robot = DUAL_PANDA,
) -> Callable[[str, int], Query]:
    """Return (group, index) -> query, from the stored set of the seed if there is one."""
    generator = QueryGenerator(seed, obstacles_n, blocked_fraction, robot)
    if (obstacles_n, blocked_fraction, robot) != (OBSTACLES_N, 1.0, ROBOT):
        return generator.query

    def source(group: str, index: int) -> Query:
        query = stored_query(seed, group, index)
        return generator.query(group, index) if query is None else query

    return source


class StoredGroup(NamedTuple):
    """Stored queries of one group.

    Attributes:
        attempts: (k,) numbers of the scenes.
        seeds: (k,) of the queries.
        ends: (k, 2, n) starts and goals [rad].
    """

    attempts: Array
    seeds: Array
    ends: Array


@cache
def stored_set(seed: int) -> dict[str, StoredGroup] | None:
    """Return the stored queries of a seed by group, or None.

    Raises:
        DataError: The file is damaged.
    """
    file = files("minidual.trials.planning") / "query_sets" / f"seed-{seed}.npz"
    if not file.is_file():
        return None
    try:
        with file.open("rb") as opened, np.load(opened, allow_pickle=False) as archive:
            arrays = dict(archive)
        stored_seed = int(arrays["seed"])
        groups = {
            group: StoredGroup(
                attempts=arrays[f"{group}.attempts"],
                seeds=arrays[f"{group}.seeds"],
                ends=stored(arrays[f"{group}.ends"]),
            )
            for group in ROBOT.groups
        }
    except (OSError, ValueError, KeyError) as error:
        raise DataError(f"the stored query set of seed {seed} cannot be read: {error}") from error
    if stored_seed != seed:
        raise DataError(f"the stored query set of seed {seed} says it is of seed {stored_seed}")
    return groups


def stored_query(seed: int, group: str, index: int) -> Query | None:
    """Return a stored query, or None beyond the sets."""
    groups = stored_set(seed)
    if groups is None or index >= len(groups[group].attempts):
        return None
    queries = groups[group]
    attempt = int(queries.attempts[index])
    start, goal = queries.ends[index]
    return Query(
        group=group,
        index=index,
        seed=int(queries.seeds[index]),
        scene=scene_of(seed, group, index, attempt, OBSTACLES_N, ROBOT),
        q_start=start,
        q_goal=goal,
        kind=QueryGenerator.kind_of(group, index),
        attempt=attempt,
    )


def stored(q: Array) -> Array:
    """Return configurations (..., n) as stored: single precision, inside the limits."""
    return np.clip(np.asarray(q, dtype=np.float32).astype(float), ROBOT.q_lower, ROBOT.q_upper)


def polyline_states(path: Array, step_rad: float = STEP_RAD) -> Array:
    """Return states (m, n) along a polyline (k, n), at most step_rad apart."""
    parts = [path[:1]]
    for a, b in pairwise(path):
        count = max(1, int(np.ceil(np.abs(b - a).max() / step_rad)))
        parts.append(a + np.linspace(0.0, 1.0, count + 1)[1:, None] * (b - a))
    return np.concatenate(parts)
