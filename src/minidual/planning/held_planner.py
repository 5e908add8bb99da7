"""Move an object that both hands hold to a new pose, round whatever stands in the way.

Three ways are tried, the fast one first: the object straight to its goal, both hands following; RRT-Connect over the
object's poses, the hands following by inverse kinematics; OMPL on the manifold of the grasp constraint. Whatever finds
a path, the same things happen to it then: made short, corners rounded, solved finely so that no hand strays, timed,
and proven with the object in the collision scene. Only what passes that proof is returned.
"""

from __future__ import annotations

import itertools
import time
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from minidual.config.planning import PlannerConfig
from minidual.errors import UsageError
from minidual.planning.blend import rounded
from minidual.planning.closed_chain import CARRY_LIMITS, continued, require_held
from minidual.planning.constrained_search import search_manifold
from minidual.planning.edges import EdgeChecker
from minidual.planning.errors import ClosedChainError, NoPathInTimeError, PlanningError, TimingError
from minidual.planning.goals import PoseGoals, check_joints, require_free
from minidual.planning.grasp_constraint import GraspConstraint
from minidual.planning.hands_ik import HandsIK
from minidual.planning.held_path import CarriedTrajectory, HeldCurve, ObjectLimits, fine_curve, timed
from minidual.planning.held_search import search_object, shorten
from minidual.planning.held_space import JOINT_WEIGHT_M, HeldSpace, Q, X
from minidual.planning.ik import check_pose
from minidual.planning.object_path import ObjectPath
from minidual.planning.scene import PlanningScene
from minidual.planning.scene_engines import SceneEngines
from minidual.planning.timing import MotionLimits
from minidual.robot.constants import ARMS, Q_LOWER, Q_UPPER, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import inverse

_SCENES_KEPT = 8
_CORNER_M = 0.06
_SHORTEN_ROUNDS_N = 10
_GOALS_N = 4
_GOAL_RESTARTS_N = 30
_LIMIT_ROOM_RAD = 1e-4
_TREE_CHECKS_N = 3000
_TREE_CHECKS_MAX_N = 100_000
_PADDING_MIN_M = 0.001
_BOX_RAD = 0.7
_CORNER_SHRINKS_N = 3


@dataclass(frozen=True)
class HeldQuery:
    """One problem: where the arms are, what they hold and how, where it shall go, what stands round.

    Attributes:
        q_start: All 14 joints, both hands at their grasps.
        T_world_goal: Pose (4, 4) of the object at the goal.
        T_object_tcp_left, T_object_tcp_right: Grasps (4, 4).
        scene: Scene with the object in the hands (`scene_holding`).
        seed: Of the random numbers.
    """

    q_start: Array
    T_world_goal: Array
    T_object_tcp_left: Array
    T_object_tcp_right: Array
    scene: PlanningScene
    seed: int = 0

    def checked(self) -> HeldQuery:
        """Return the query with its arrays checked.

        Raises:
            OutOfLimitsError, UsageError: A bad start, goal or grasp.
        """
        return replace(
            self,
            q_start=check_joints(self.q_start, "start"),
            T_world_goal=check_pose(self.T_world_goal, "the goal of the object"),
            T_object_tcp_left=check_pose(self.T_object_tcp_left, "the left grasp"),
            T_object_tcp_right=check_pose(self.T_object_tcp_right, "the right grasp"),
        )


class HeldPlanner:
    """Plans moves of held objects. One instance a process: it holds workspaces.

    Args:
        limits: Limits of the joints' motion.
        object_limits: Speed and acceleration of the object.
        config: Padding, step and budget of the search.
    """

    def __init__(
        self,
        limits: MotionLimits | None = None,
        object_limits: ObjectLimits | None = None,
        config: PlannerConfig | None = None,
    ) -> None:
        self._limits = limits or CARRY_LIMITS
        self._object_limits = object_limits or ObjectLimits()
        self._config = config or PlannerConfig()
        self._kinematics = Kinematics()
        self._goals = PoseGoals()
        self._engines: OrderedDict[PlanningScene, SceneEngines] = OrderedDict()

    def engines(self, scene: PlanningScene) -> SceneEngines:
        """Return the engines of a scene, from the last few scenes or newly built."""
        if scene not in self._engines:
            self._engines[scene] = SceneEngines(scene, self._kinematics)
            while len(self._engines) > _SCENES_KEPT:
                self._engines.popitem(last=False)
        self._engines.move_to_end(scene)
        return self._engines[scene]

    def plan(self, query: HeldQuery, budget_s: float | None = None) -> CarriedTrajectory:
        """Return a proven trajectory that brings the object to its goal.

        Args:
            query: The problem; the same query gives the same trajectory.
            budget_s: Wall time after which to give up; the configuration's by default.

        Raises:
            ClosedChainError: The hands are off their grasps at the start.
            StartInCollisionError, GoalInCollisionError: Start, or every posture found at the goal, touches something.
            IKUnreachableError: A hand cannot reach its grasp at the goal; with the residual.
            NoPathInTimeError: No path passed the proof; with what stopped the straight one and the last one.
            OutOfLimitsError, UsageError: Bad numbers.
        """
        query = query.checked()
        budget = self._config.budget_s if budget_s is None else budget_s
        if not (np.isfinite(budget) and budget > 0.0):
            raise UsageError(f"budget_s = {budget}; it must be a finite number > 0")
        work = _Work(self, query, time.perf_counter() + budget)
        return work.run()


class _Work:
    """One query while it is planned."""

    def __init__(self, planner: HeldPlanner, query: HeldQuery, deadline: float) -> None:
        self._planner = planner
        self._query = query
        self._deadline = deadline
        self._kinematics = planner._kinematics
        self._grasps = (query.T_object_tcp_left, query.T_object_tcp_right)
        self._hands = HandsIK(*self._grasps, self._kinematics)
        self._engines = planner.engines(query.scene)
        left, _ = self._kinematics.tcp_poses(query.q_start)
        self._T_start = left @ inverse(query.T_object_tcp_left)
        require_held(self._hands, query.q_start, self._T_start)
        require_free(self._engines.mujoco, query.q_start, "start")
        self._rejections: list[str] = []

    def run(self) -> CarriedTrajectory:
        path = ObjectPath([self._T_start, self._query.T_world_goal])
        self._chart = path.chart
        straight = self._straight(path)
        if isinstance(straight, CarriedTrajectory):
            return straight
        for method, points, attempt in self._found(straight):
            if points is None:
                self._rejections.append(f"{method} found no path")
                continue
            try:
                return self._finish(points, method, attempt)
            except (ClosedChainError, TimingError) as error:
                self._rejections.append(f"{method}: {error.message}")
        straight_why, last = self._rejections[0], self._rejections[-1]
        raise NoPathInTimeError(
            f"no proven path for the held object within the budget: straight, {straight_why}; "
            f"{len(self._rejections)} attempts, the last one: {last}",
            remedy="raise the budget, make room in the scene, or choose another goal or grasp",
        )

    def _straight(self, path: ObjectPath) -> CarriedTrajectory | Array | None:
        """Return the proven straight move; or the posture (14,) at its end if only the way is blocked; or None."""
        try:
            curve, residual_m, residual_rad = continued(self._hands, path, self._query.q_start)
        except ClosedChainError as error:
            self._rejections.append(error.message)
            return None
        end = curve.at(np.array([curve.length]))[0, :14]
        checker = self._checker(end)
        rows = curve.at(np.linspace(0.0, curve.length, 2 * len(curve.marks)))[:, :14]
        if not checker.all_free(rows):
            self._rejections.append(f"the straight way is blocked: {self._touching(rows)}")
            return end
        try:
            return self._timed(curve, residual_m, residual_rad, "continuation")
        except (ClosedChainError, TimingError) as error:
            self._rejections.append(error.message)
            return end

    def _checker(self, q_goal: Array, padding_m: float | None = None) -> EdgeChecker:
        config = self._planner._config
        padding = config.padding_m if padding_m is None else padding_m
        return EdgeChecker(self._engines.mujoco, padding, (self._query.q_start, q_goal), config.edge_step_rad)

    def _touching(self, rows: Array) -> str:
        """Return which parts touch, or come too near, first along configurations (n, 14)."""
        padding = self._planner._config.padding_m
        for k, q in enumerate(rows):
            near = self._engines.mujoco.closest(q, padding)
            if near and near[0].distance_m < 0.5 * padding:
                return f"{near[0]} after {k / max(1, len(rows) - 1):.0%} of it"
        return "parts come nearer than the padding"

    def _goal_postures(self, end: Array | None, wanted_n: int) -> list[Array]:
        """Return free postures (14,) at the goal: the end of the straight continuation first, then the nearest."""
        mujoco = self._engines.mujoco
        goals = [end] if end is not None and not mujoco.in_collision(end) else []
        if len(goals) >= wanted_n:
            return goals
        targets = {
            arm: self._query.T_world_goal @ grasp for arm, grasp in zip(ARMS, self._grasps, strict=True)
        }
        try:
            more = self._planner._goals.candidates(
                "both_arms", self._query.q_start, targets, mujoco, np.random.default_rng([self._query.seed, 1]),
                restarts_n=_GOAL_RESTARTS_N, candidates_n=wanted_n,
            )  # fmt: skip
        except PlanningError:
            if not goals:
                raise
            more = []
        for q in more:
            if all(np.abs(q - other).max() > 1e-3 for other in goals):
                goals.append(q)
        inside = (np.clip(q, Q_LOWER + _LIMIT_ROOM_RAD, Q_UPPER - _LIMIT_ROOM_RAD) for q in goals)
        held = [self._hands.solve(self._query.T_world_goal, q) for q in inside]
        return [q for q in held if q is not None]

    def _space(self, goals: Sequence[Array], padding_m: float) -> HeldSpace:
        return HeldSpace(self._hands, self._chart, self._checker(goals[0], padding_m))

    def _found(self, end: Array | None) -> Iterator[tuple[str, Array | None, int]]:
        """Yield (method, points (n, 20) or None, attempt) until the deadline."""
        query, attempt = self._query, 0
        padding, checks = self._planner._config.padding_m, _TREE_CHECKS_N
        constraint = GraspConstraint.from_grasps(*self._grasps, self._kinematics)
        held: list[Array] = []
        while time.perf_counter() < self._deadline:
            if attempt < 2:  # one posture is enough for most; the others cost more than the search
                held = self._goal_postures(end, 1 if attempt == 0 else _GOALS_N)
            if not held:
                self._rejections.append("every posture found at the goal lies at a joint limit")
                attempt += 1
                if attempt > 2:
                    return
                continue
            space = self._space(held, padding)
            start = space.point(self._T_start, query.q_start)
            ends = [space.point(query.T_world_goal, q) for q in held]
            if attempt % 4 < 2:
                rng = np.random.default_rng([query.seed, 2, attempt])
                yield (
                    "object_rrt",
                    search_object(space, start, ends, rng, checks_max=checks, deadline=self._deadline),
                    attempt,
                )
            else:
                method = "atlas" if attempt % 4 == 2 else "projected"
                configurations = search_manifold(
                    constraint, space.checker, query.q_start, held, space=method, box_rad=_BOX_RAD,
                    seed=query.seed + attempt, checks_max=checks, deadline=self._deadline,
                )  # fmt: skip
                points = None if configurations is None else self._points(space, configurations)
                yield method, points, attempt
            attempt += 1
            padding, checks = max(0.7 * padding, _PADDING_MIN_M), min(2 * checks, _TREE_CHECKS_MAX_N)

    def _points(self, space: HeldSpace, configurations: Array) -> Array | None:
        """Return the points (n, 20) of configurations on the manifold if the edges between them can be followed."""
        T_tcp_object = inverse(self._grasps[0])
        points = np.array([
            space.point(self._kinematics.tcp_poses(q)[0] @ T_tcp_object, q) for q in configurations
        ])  # fmt: skip
        linked = all(space.edge_free(a, b) for a, b in itertools.pairwise(points))
        return points if linked else None

    def _finish(self, points: Array, method: str, attempt: int) -> CarriedTrajectory:
        """Shorten, round, solve, time and prove.

        Raises:
            ClosedChainError, TimingError: What stopped it.
        """
        rng = np.random.default_rng([self._query.seed, 3, attempt])
        space = self._space(
            [points[-1, Q]], max(self._planner._config.padding_m * 0.7**attempt, _PADDING_MIN_M)
        )
        points = shorten(space, points, rng, _SHORTEN_ROUNDS_N)
        corner = _CORNER_M
        for shrink in range(_CORNER_SHRINKS_N):
            try:
                curve, residual_m, residual_rad = self._curve(points, corner)
                return self._timed(curve, residual_m, residual_rad, method)
            except ClosedChainError:
                if shrink == _CORNER_SHRINKS_N - 1:
                    raise
                corner *= 0.4
        raise AssertionError("unreachable: the last shrink returns or raises")

    def _curve(self, points: Array, corner: float) -> tuple[HeldCurve, float, float]:
        # Joints count for a tenth of a metre a radian, so that the points of the curve are dense where the object is.
        scale = np.ones(points.shape[1])
        scale[Q] = JOINT_WEIGHT_M
        smooth = rounded(points * scale, corner)

        def coordinates(s: Array, order: int) -> Array:
            return smooth.at(s, order)[:, X]

        def solve(marks: Array, Ts_world_object: Array) -> Array:
            seeds = smooth.at(marks)[:, Q] / JOINT_WEIGHT_M
            solved = np.empty_like(seeds)
            for k, (T, seed) in enumerate(zip(Ts_world_object, seeds, strict=True)):
                q = self._hands.solve(T, seed)
                if q is None:
                    x, y, z = T[:3, 3]
                    raise ClosedChainError(
                        f"the hands cannot hold the object at ({x:.3f}, {y:.3f}, {z:.3f}) m"
                    )
                solved[k] = q
            return solved

        return fine_curve(self._hands, self._chart, smooth.length, smooth.knots, coordinates, solve)

    def _timed(
        self, curve: HeldCurve, residual_m: float, residual_rad: float, method: str
    ) -> CarriedTrajectory:
        trajectory, poses = timed(
            curve, self._chart, self._planner._object_limits, self._planner._limits, self._kinematics
        )
        report = self._engines.verifier.verify(trajectory)
        if not report.ok:
            raise ClosedChainError(f"the carried path is not free: {report.reason}")
        return CarriedTrajectory(
            trajectory.times, trajectory.q, trajectory.v, trajectory.a, trajectory.group,
            poses, residual_m, residual_rad, report, method,
        )  # fmt: skip
