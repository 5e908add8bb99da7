"""Seeded moves of an object held in both hands.

Goals are up to 0.5 m and 90 degrees away; in every second move obstacles block the straight path.
Each move has a witness: a timed, proven path of a long search.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from minidual.collision.engines import MujocoEngine
from minidual.collision.errors import ClosedChainError, PlanningError, TimingError
from minidual.collision.scene import TABLE, PlanningScene
from minidual.config.scene import SceneConfig
from minidual.config.seeds import stream
from minidual.motion.api import Planner
from minidual.motion.budget import Budget
from minidual.motion.held.hands import HandsIK
from minidual.motion.held.path import HeldPath, ObjectChart
from minidual.motion.held.planner import HeldPlanner, HeldWork
from minidual.motion.held.query import HeldQuery, scene_holding
from minidual.motion.held.search import search_object
from minidual.motion.held.space import HeldSpace
from minidual.motion.search import EdgeChecker
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.pair import DUAL_PANDA, SIDES, Array, Robot, pose, rot_x, rot_z
from minidual.skills.things import thing_of
from minidual.tasks.task import grasp_offsets
from minidual.trials.planning.queries import random_obstacles

_ROOM_M = 0.01
_MOVE_MAX_M = 0.5
_TURN_MAX_RAD = float(np.pi / 2.0)
_YAW_RAD = 0.6
_LEAN_RAD = 0.25
_OBSTACLES_N = 3
_WITNESS_CHECKS_N = 10_000
_WITNESS_WORK_N = 1_000_000
"""Of one search, in state checks, its inverse kinematics included."""
_SCENES_N = 200
_GOALS_N = 4
_IK_STARTS_N = 6
_WITNESS_TRIES = ((0.005, 1.0), (0.008, 0.5), (0.002, 0.5))
"""Padding [m] and check step scale."""
_EDGE_STEP_RAD = 0.03
_LOW = np.array([0.35, -0.3, 0.08])
_HIGH = np.array([0.6, 0.3, 0.4])


class _Hold(NamedTuple):
    """Pose (4, 4) of the object, and posture q (n,) [rad] of the hands on it."""

    T_world_object: Array
    q: Array


class _Candidate(NamedTuple):
    """A drawn move before its witness is searched."""

    query: HeldQuery
    engines: SceneEngines
    start: _Hold
    goal: _Hold
    blocked: bool


@dataclass
class _Counts:
    """Draws left out so far: without a witness, and without a free posture."""

    undecided: int = 0
    unreachable: int = 0


@dataclass(frozen=True, eq=False)
class HeldMove:
    """One move.

    Attributes:
        blocked: Whether the straight path collides or cannot be followed.
        witness: Points (m, 6 + n) of a proven path.
        undecided_n, unreachable_n: Draws left out before it: no witness, no free posture.
    """

    index: int
    query: HeldQuery
    T_world_start: Array
    with_obstacles: bool
    blocked: bool
    witness: Array
    undecided_n: int
    unreachable_n: int


class HeldMoveGenerator:
    """Makes moves, reproducible: a witness search ends after counted work.

    With `from_table` the object starts level on the table, without obstacles.
    """

    def __init__(
        self,
        seed: int,
        scene: SceneConfig,
        robot: Robot = DUAL_PANDA,
        *,
        from_table: bool = False,
    ) -> None:
        self._seed = seed
        self._from_table = from_table
        self._height_m = scene.object.rest_height_m
        self._grasps = grasp_offsets(scene)
        self._shape = thing_of(scene.object).shape
        self._prover = HeldPlanner(Planner(robot=robot))
        self._robot = robot
        self._hands = HandsIK(self._grasps, robot)

    def move(self, index: int) -> HeldMove:
        """Return move `index`; odd ones have obstacles.

        Raises:
            PlanningError: None was found.
        """
        rng = stream(self._seed, "held-move/table" if self._from_table else "held-move", index)
        with_obstacles = index % 2 == 1 and not self._from_table
        counts = _Counts()
        for _ in range(_SCENES_N):
            for candidate in self._candidates(rng, with_obstacles, counts):
                witness = self._witness(rng, candidate)
                if witness is None:
                    counts.undecided += 1
                    continue
                return HeldMove(
                    index=index,
                    query=candidate.query,
                    T_world_start=candidate.start.T_world_object,
                    with_obstacles=with_obstacles,
                    blocked=candidate.blocked,
                    witness=witness,
                    undecided_n=counts.undecided,
                    unreachable_n=counts.unreachable,
                )
        left_out = f"{counts.undecided} without a witness, {counts.unreachable} unreachable"
        raise PlanningError(
            f"no held-object move {index} after {_SCENES_N} scenes ({left_out})",
            remedy="use fewer obstacles or a shorter object",
        )

    def _candidates(
        self,
        rng: np.random.Generator,
        with_obstacles: bool,
        counts: _Counts,
    ) -> Iterator[_Candidate]:
        """Draw a scene with a start, and yield reachable goals in it; count those that are not.

        With obstacles they are goals to which the straight path is blocked.
        """
        scene = self._scene(rng, with_obstacles)
        engines = SceneEngines(scene)
        engine = engines.engine("mujoco")
        room_m = 0.0 if self._from_table else _ROOM_M
        start = self._hold(rng, engine, self._start(rng), self._robot.home, room_m)
        if start is None:
            counts.unreachable += 1
            return
        for _ in range(_GOALS_N):
            T_goal = _random_goal(rng, start.T_world_object)
            goal = self._hold(rng, engine, T_goal, start.q, _ROOM_M)
            if goal is None:
                counts.unreachable += 1
                continue
            blocked = self._blocked(engine, start, T_goal)
            if with_obstacles and not blocked:
                continue
            seed = int(rng.integers(2**31))
            query = HeldQuery(start.q, T_goal, self._grasps, scene, seed)
            yield _Candidate(query, engines, start, goal, blocked)

    def _scene(self, rng: np.random.Generator, with_obstacles: bool) -> PlanningScene:
        """Return a scene with the object in both hands."""
        obstacles = random_obstacles(rng, _OBSTACLES_N, self._robot) if with_obstacles else ()
        return scene_holding(
            PlanningScene(obstacles=(TABLE, *obstacles), robot=self._robot),
            self._shape,
            dict(zip(SIDES, self._grasps, strict=True)),
            rests_on=("table",) if self._from_table else (),
        )

    def _start(self, rng: np.random.Generator) -> Array:
        yaw = rng.uniform(-_YAW_RAD, _YAW_RAD)
        lean = rng.uniform(-_LEAN_RAD, _LEAN_RAD)
        position = rng.uniform(_LOW, _HIGH)
        if self._from_table:
            lean = 0.0
            position[2] = self._height_m
        return pose(rot_z(yaw) @ rot_x(lean), position)

    def _hold(
        self,
        rng: np.random.Generator,
        engine: MujocoEngine,
        T_world_object: Array,
        q_near: Array,
        room_m: float,
    ) -> _Hold | None:
        """Return a posture of the hands on the object that keeps `room_m` from everything."""
        for attempt in range(_IK_STARTS_N):
            q = self._reach(rng, T_world_object, q_near, from_near=attempt == 0)
            if q is None:
                continue
            solved = self._hands.solve(T_world_object, q)
            if solved is not None and not engine.closest(solved, room_m):
                return _Hold(T_world_object, solved)
        return None

    def _reach(
        self,
        rng: np.random.Generator,
        T_world_object: Array,
        q_near: Array,
        *,
        from_near: bool,
    ) -> Array | None:
        """Return the IK of both hands, from `q_near` or from a random posture; None if it fails."""
        q = np.array(q_near)
        for arm, T_object_tcp in zip(self._hands.arms, self._grasps, strict=True):
            begin = q_near[arm.joints] if from_near else rng.uniform(arm.lower, arm.upper)
            solution = arm.solve(T_world_object @ T_object_tcp, begin)
            if not solution.reached:
                return None
            q[arm.joints] = solution.q
        return q

    def _blocked(self, engine: MujocoEngine, start: _Hold, T_goal: Array) -> bool:
        """Return whether the straight path collides or cannot be followed."""
        path = HeldPath.through([start.T_world_object, T_goal])
        marks = np.linspace(0.0, path.length, max(8, int(path.length / 0.01)), dtype=np.float64)
        Q, ended = self._hands.follow(path.poses(marks), start.q)
        return ended is not None or bool(engine.collisions(Q).any())

    def _witness(self, rng: np.random.Generator, candidate: _Candidate) -> Array | None:
        """Return points of a proven path from start to goal, or None."""
        start = candidate.start
        goal = candidate.goal
        ends = (start.q, goal.q)
        chart = ObjectChart(start.T_world_object[:3, :3])
        for padding_m, step_scale in _WITNESS_TRIES:
            checker = EdgeChecker(candidate.engines, padding_m, ends, _EDGE_STEP_RAD)
            space = HeldSpace(self._hands, chart, checker, step_scale)
            checker.allow(_WITNESS_CHECKS_N, Budget(_WITNESS_WORK_N))
            path = search_object(
                space,
                space.point(*goal),
                [space.point(*start)],
                rng,
                any_posture=False,
            )
            if path is None:
                continue
            from_start = path[::-1]
            with suppress(ClosedChainError, TimingError):
                HeldWork(self._prover.planner, candidate.query).rounded(from_start, "given")
                return from_start
        return None


def _random_goal(rng: np.random.Generator, T_world_start: Array) -> Array:
    """Return a pose with uniform distance and angle; half of them turn about the vertical."""
    direction = rng.normal(size=3)
    offset = rng.uniform(0.05, _MOVE_MAX_M) * direction / np.linalg.norm(direction)
    angle = rng.uniform(-_TURN_MAX_RAD, _TURN_MAX_RAD)
    if rng.random() < 0.5:
        turn = rot_z(angle)
    else:
        axis = rng.normal(size=3)
        weighted = 0.2 * angle * axis / np.linalg.norm(axis)
        turn = ObjectChart(np.eye(3)).pose(np.append(np.zeros(3), weighted))[:3, :3]
    return pose(turn @ T_world_start[:3, :3], T_world_start[:3, 3] + offset)
