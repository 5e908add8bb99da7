"""Seeded planning queries around a table with obstacles, and stored sets of them.

IK solves poses over the table; no planner is used. A set holds one hundred hard queries per group, for two seeds and the
default robot. Each of these has a witness: corners of a polyline that both engines find free every 0.002 rad.
`python scripts/make_query_set.py SEED` makes a set.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files
from itertools import pairwise

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


@dataclass(frozen=True, eq=False)
class Query:
    """What to plan.

    Attributes:
        q_start: Free (n,) [rad].
        q_goal: Free (n,) [rad]. For a goal of poses the plan may end in another IK solution of `targets`.
        kind: Why it is hard: the straight line runs into an obstacle ("past_obstacle") or the other arm ("past_arm"),
            or is blocked while the hands change sides ("crossing"); or "any".
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
            if (query := self.attempt(group, index, attempt)) is not None:
                return query
        none = f"no query {index} for {group} with {self.obstacles_n} obstacles after {_SCENE_TRIES_N} scenes"
        raise PlanningError(none, remedy="use fewer obstacles or a smaller blocked_fraction")

    def attempt(self, group: str, index: int, attempt: int) -> Query | None:
        """Return the query of one scene, or None."""
        arms = GROUP_ARMS[group]
        kind = self.kind(group, index)
        scene = scene_of(self.seed, group, index, attempt, self.obstacles_n, self.robot)
        rng = stored_stream(self.seed, list(DUAL_PANDA.groups).index(group), index, attempt, 1)
        engine = MujocoEngine(scene)
        crossed = kind == "crossing"
        at_goal = bool(rng.integers(2)) and crossed
        for _ in range(_PAIRS_TRIES_N):
            start = self._configuration(
                rng,
                engine,
                self.robot.home,
                SIDES,
                crossed and not at_goal,
            )
            if (
                start is None
                or (goal := self._configuration(rng, engine, start, arms, at_goal)) is None
            ):
                continue
            way = polyline_states(np.array([start, goal]), _STEP_RAD)[1:-1]
            if not _is_kind(
                kind,
                arms,
                set[frozenset[str]]().union(*map(engine.touching_pairs, way)),
            ):
                continue
            if crossed and not _swapped(
                *(goal_targets(group, q, self.robot) for q in (start, goal)),
            ):
                continue
            return Query(group, index, int(rng.integers(2**31)), scene, start, goal, kind, attempt)
        return None

    def _configuration(
        self,
        rng: np.random.Generator,
        engine: MujocoEngine,
        q_base: Array,
        arms: tuple[str, ...],
        crossed: bool,
    ) -> Array | None:
        for _ in range(_POSE_TRIES_N):
            q = np.array(q_base)
            for arm in arms:
                T_world_tcp = random_pose(rng, arm)
                if crossed:
                    T_world_tcp[1, 3] = (-1.0 if arm == "left" else 1.0) * rng.uniform(0.03, 0.25)
                if (solution := self._reach(rng, arm, T_world_tcp)) is None:
                    break
                q[solvers(self.robot)[arm].joints] = solution
            else:
                if not engine.closest(q, _ROOM_M):
                    return q
        return None

    def _reach(self, rng: np.random.Generator, arm: str, T_world_tcp: Array) -> Array | None:
        solver = solvers(self.robot)[arm]
        home = self.robot.home[solver.joints]
        starts = (
            home if k == 0 else rng.uniform(solver.lower, solver.upper) for k in range(_IK_STARTS_N)
        )
        solutions = (solver.solve(T_world_tcp, start) for start in starts)
        return next((solution.q for solution in solutions if solution.reached), None)


def goal_targets(group: str, q: Array, robot: Robot) -> dict[str, Array]:
    """Return T_world_tcp (4, 4) of the group's arms."""
    return {
        arm: solvers(robot)[arm].tcp_pose(q[robot.groups[f"{arm}_arm"]])
        for arm in GROUP_ARMS[group]
    }


def _swapped(before: dict[str, Array], after: dict[str, Array]) -> bool:
    a, b = (hands["left"][1, 3] - hands["right"][1, 3] for hands in (before, after))
    return a * b < 0.0 and min(abs(a), abs(b)) > _CROSSED_BY_M


def _is_kind(kind: str, arms: tuple[str, ...], touched: set[frozenset[str]]) -> bool:
    mine = tuple(f"{arm}_" for arm in arms)
    theirs = tuple(f"{arm}_" for arm in SIDES if arm not in arms)

    def between_mine_and(wanted: Callable[[str], bool]) -> bool:
        return any(
            any(n.startswith(mine) for n in pair) and any(map(wanted, pair)) for pair in touched
        )

    if kind == "past_obstacle":
        return between_mine_and(lambda name: not name.startswith(("left_", "right_", "table")))
    if kind == "past_arm":
        return between_mine_and(lambda name: name.startswith(theirs))
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
    rng = stored_stream(seed, list(DUAL_PANDA.groups).index(group), index, attempt, 0)
    return PlanningScene(obstacles=(TABLE, *random_obstacles(rng, obstacles_n, robot)), robot=robot)


def random_pose(rng: np.random.Generator, arm: str) -> Array:
    """Return a tcp pose (4, 4) over the table, hand down."""
    side = 1.0 if arm == "left" else -1.0
    position = np.array(
        [rng.uniform(0.30, 0.65), side * rng.uniform(-0.15, 0.55), rng.uniform(0.08, 0.45)],
    )
    yaw, about = rng.uniform(-np.pi, np.pi, 2)
    lean = rot_z(about) @ rot_x(rng.uniform(0.0, _TILT_RAD)) @ rot_z(-about)
    return pose(lean @ rot_z(yaw) @ rot_x(np.pi), position)


def random_obstacles(
    rng: np.random.Generator,
    count: int,
    robot: Robot = DUAL_PANDA,
) -> tuple[Shape, ...]:
    """Return boxes and cylinders clear of the bases."""
    shapes: list[Shape] = []
    for k in range(count):
        height = float(rng.uniform(0.10, 0.40))
        while True:
            x = float(rng.uniform(0.25, 0.75))
            y = float(rng.uniform(-0.60, 0.60))
            if all(np.hypot(x - bx, y - by) > 0.28 for bx, by, _ in robot.base_positions_m):
                break
        place = (round(x, 4), round(y, 4), round(0.5 * height, 4))
        if rng.random() < 0.5:
            x_m, y_m = (round(float(rng.uniform(0.05, 0.16)), 4) for _ in range(2))
            half_yaw = 0.5 * float(rng.uniform(-np.pi / 2, np.pi / 2))
            quat = (float(np.cos(half_yaw)), 0.0, 0.0, float(np.sin(half_yaw)))
            shapes.append(Box(f"box{k}", place, quat, (x_m, y_m, round(height, 4))))
        else:
            radius = round(float(rng.uniform(0.025, 0.07)), 4)
            shapes.append(
                Cylinder(f"cylinder{k}", place, radius_m=radius, length_m=round(height, 4)),
            )
    return tuple(shapes)


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
    return lambda group, index: stored_query(seed, group, index) or generator.query(group, index)


@cache
def stored_set(seed: int) -> dict[str, tuple[Array, Array, Array]] | None:
    """Return {group: (attempts (k,), seeds (k,), starts and goals (k, 2, n))} of a seed, or None.

    Raises:
        DataError: The file is damaged.
    """
    file = files("minidual.trials.planning") / "query_sets" / f"seed-{seed}.npz"
    if not file.is_file():
        return None
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as opened:
            arrays = dict(opened)
        of = int(arrays["seed"])
        found = {
            g: (arrays[f"{g}.attempts"], arrays[f"{g}.seeds"], stored(arrays[f"{g}.ends"]))
            for g in ROBOT.groups
        }
    except (OSError, ValueError, KeyError) as error:
        raise DataError(f"the stored query set of seed {seed} cannot be read: {error}") from error
    if of != seed:
        raise DataError(f"the stored query set of seed {seed} says it is of seed {of}")
    return found


def stored_query(seed: int, group: str, index: int) -> Query | None:
    """Return a stored query, or None beyond the sets."""
    known = stored_set(seed)
    if known is None or index >= len(known[group][0]):
        return None
    attempt, own_seed, (start, goal) = (column[index] for column in known[group])
    scene = scene_of(seed, group, index, int(attempt), OBSTACLES_N, ROBOT)
    return Query(
        group,
        index,
        int(own_seed),
        scene,
        start,
        goal,
        QueryGenerator.kind_of(group, index),
        int(attempt),
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
