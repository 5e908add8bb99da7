"""Seeded moves of an object held in both hands.

Goals are up to 0.5 m and 90 degrees away; in every second move obstacles block the straight path. Each move has a
witness: a timed, proven path of a long search.
"""

import time
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from minidual.collision.engines import MujocoEngine
from minidual.collision.errors import ClosedChainError, PlanningError, TimingError
from minidual.collision.scene import TABLE, PlanningScene
from minidual.config.scene import SceneConfig
from minidual.config.seeds import stream
from minidual.motion.api import Planner
from minidual.motion.held.hands import HandsIK
from minidual.motion.held.path import HeldPath, ObjectChart
from minidual.motion.held.planner import HeldPlanner, HeldQuery, HeldWork, scene_holding
from minidual.motion.held.search import HeldSpace, search_object
from minidual.motion.search import EdgeChecker
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.pair import DUAL_PANDA, SIDES, Array, Robot, pose, rot_x, rot_z
from minidual.skills.cycle import thing_of
from minidual.tasks.task import grasp_offsets
from minidual.trials.planning.queries import random_obstacles

_ROOM_M = 0.01
_MOVE_MAX_M = 0.5
_TURN_MAX_RAD = float(np.pi / 2.0)
_YAW_RAD = 0.6
_LEAN_RAD = 0.25
_OBSTACLES_N = 3
_WITNESS_CHECKS_N = 10_000
_WITNESS_S = 60.0
_TRIES_N = 200
_IK_STARTS_N = 6
_WITNESS_TRIES = ((0.005, 1.0), (0.008, 0.5), (0.002, 0.5))
"""Padding [m] and check step scale."""
_EDGE_STEP_RAD = 0.03
_LOW = np.array([0.35, -0.3, 0.08])
_HIGH = np.array([0.6, 0.3, 0.4])


type _Held = tuple[Array, Array]
"""Object pose (4, 4), posture (n,) of the hands on it."""


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
    """Makes moves, reproducible if a witness search makes its 10 000 state checks within 60 s.

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
        rests_on = ("table",) if self._from_table else ()
        undecided = unreachable = 0
        for _ in range(_TRIES_N):
            obstacles = random_obstacles(rng, _OBSTACLES_N, self._robot) if with_obstacles else ()
            room = PlanningScene(obstacles=(TABLE, *obstacles), robot=self._robot)
            scene = scene_holding(
                room,
                self._shape,
                dict(zip(SIDES, self._grasps, strict=True)),
                rests_on=rests_on,
            )
            engines = SceneEngines(scene)
            engine = engines.engine("mujoco")
            apart_m = 0.0 if self._from_table else _ROOM_M
            if (
                start := self._held(rng, engine, self._start(rng), self._robot.home, apart_m)
            ) is None:
                unreachable += 1
                continue
            for _ in range(4):
                T_goal = _random_goal(rng, start[0])
                if (goal := self._held(rng, engine, T_goal, start[1], _ROOM_M)) is None:
                    unreachable += 1
                    continue
                blocked = self._blocked(engine, start, T_goal)
                if with_obstacles and not blocked:
                    continue
                query = HeldQuery(start[1], T_goal, self._grasps, scene, int(rng.integers(2**31)))
                if (witness := self._witness(rng, engines, query, start, goal)) is None:
                    undecided += 1
                    continue
                return HeldMove(
                    index,
                    query,
                    start[0],
                    with_obstacles,
                    blocked,
                    witness,
                    undecided,
                    unreachable,
                )
        why = f"{undecided} without a witness, {unreachable} unreachable"
        remedy = "use fewer obstacles or a shorter object"
        raise PlanningError(
            f"no held-object move {index} after {_TRIES_N} scenes ({why})",
            remedy=remedy,
        )

    def _start(self, rng: np.random.Generator) -> Array:
        yaw = rng.uniform(-_YAW_RAD, _YAW_RAD)
        lean = rng.uniform(-_LEAN_RAD, _LEAN_RAD)
        position = rng.uniform(_LOW, _HIGH)
        if self._from_table:
            lean = 0.0
            position[2] = self._height_m
        return pose(rot_z(yaw) @ rot_x(lean), position)

    def _held(
        self,
        rng: np.random.Generator,
        engine: MujocoEngine,
        T_world_object: Array,
        q_near: Array,
        room_m: float,
    ) -> _Held | None:
        for k in range(_IK_STARTS_N):
            q = np.array(q_near)
            for arm, grasp in zip(self._hands.arms, self._grasps, strict=True):
                begin = q_near[arm.joints] if k == 0 else rng.uniform(arm.lower, arm.upper)
                solution = arm.solve(T_world_object @ grasp, begin)
                if not solution.reached:
                    break
                q[arm.joints] = solution.q
            else:
                solved = self._hands.solve(T_world_object, q)
                if solved is not None and not engine.closest(solved, room_m):
                    return T_world_object, solved
        return None

    def _blocked(self, engine: MujocoEngine, start: _Held, T_goal: Array) -> bool:
        path = HeldPath.through([start[0], T_goal])
        marks = np.linspace(0.0, path.length, max(8, int(path.length / 0.01)), dtype=np.float64)
        Q, ended = self._hands.follow(path.poses(marks), start[1])
        return ended is not None or bool(engine.collisions(Q).any())

    def _witness(
        self,
        rng: np.random.Generator,
        engines: SceneEngines,
        query: HeldQuery,
        start: _Held,
        goal: _Held,
    ) -> Array | None:
        for padding_m, step_scale in _WITNESS_TRIES:
            checker = EdgeChecker(engines, padding_m, (start[1], goal[1]), _EDGE_STEP_RAD)
            space = HeldSpace(self._hands, ObjectChart(start[0][:3, :3]), checker, step_scale)
            checker.allow(_WITNESS_CHECKS_N, time.perf_counter() + _WITNESS_S)
            path = search_object(
                space,
                space.point(*goal),
                [space.point(*start)],
                rng,
                any_posture=False,
            )
            with suppress(ClosedChainError, TimingError):
                if path is not None:
                    HeldWork(self._prover.planner, query).rounded(path[::-1], "given")
                    return path[::-1]
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
