"""Planning for an object held by both hands, along waypoints or to a goal."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from minidual.collision.errors import (
    ClosedChainError,
    NoPathInTimeError,
    PlanningError,
    TimingError,
)
from minidual.collision.scene import Attached, PlanningScene
from minidual.collision.shapes import Shape
from minidual.config.planning import MotionLimits
from minidual.config.seeds import stream, subseed
from minidual.motion.api import Planner, more_padding
from minidual.motion.blend import rounded
from minidual.motion.held.constraint import GraspConstraint, search_manifold
from minidual.motion.held.hands import HandsIK
from minidual.motion.held.path import CarriedTrajectory, HeldCurve, HeldPath, fine_curve
from minidual.motion.held.search import JOINT_WEIGHT_M, HeldSpace, Q, search_object, shorten
from minidual.motion.ik import check_joints, check_pose, place_text, pose_goals, require_free
from minidual.motion.search import EdgeChecker
from minidual.motion.timing import PathLimits
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.pair import SIDES, Array, inverse

_LIMITS = MotionLimits(smoothing_s=0.1)  # gentler than with empty hands
METHODS = (
    "object_rrt",
    "object_rrt",
    "object_rrt",
    "projected",
    "object_rrt",
    "object_rrt",
    "atlas",
)
"""Search methods by attempt, cyclic; the straight motion comes first."""
_CORNERS_M = (0.06, 0.02, 0.006)
_SHORTEN_ROUNDS_N = 10
_GOALS_N = 16
_LIMIT_ROOM_RAD = 1e-4
_MANIFOLD_GOALS_N = 4
_MORE_GOALS = {1: 1, 2: 10}
"""Attempts that first look for more goal postures: {attempt: multiple of the usual IK restarts}."""
_CANDIDATES_N = 400
_SAME_RAD = 0.5
"""Postures closer than this are duplicates."""


def placed(shape: Shape, T: Array) -> Shape:
    """Return a shape transformed by T (4, 4)."""
    T_shape = T @ shape.T_parent_shape
    x, y, z, w = pin.Quaternion(T_shape[:3, :3]).normalized().coeffs().tolist()
    return replace(shape, position_m=tuple(T_shape[:3, 3].tolist()), quat_wxyz=(w, x, y, z))


def scene_holding(
    scene: PlanningScene,
    shape: Shape,
    grasps: Mapping[str, Array],
    *,
    rests_on: Iterable[str] = ("table",),
    touching: Iterable[str] = (),
) -> PlanningScene:
    """Return the scene with `shape`, placed in the object frame, attached to the first hand of `grasps`.

    `grasps` is {arm: T_object_tcp (4, 4)}. The object may touch these hands, those `touching`, and `rests_on`.
    """
    robot = scene.robot
    first = next(iter(grasps))
    hands = tuple(link for arm in (*grasps, *touching) for link in robot.hand_links(arm))
    held = Attached(
        placed(shape, inverse(grasps[first])),
        robot.tcp_names[SIDES.index(first)],
        hands,
    )
    scene = scene.with_attached(held)
    for obstacle in rests_on:
        scene = scene.allowing(
            shape.name,
            obstacle,
            "the object is lifted off it or put down on it",
        )
    return scene


class HeldQuery(NamedTuple):
    """What to plan for a held object.

    Attributes:
        q_start: All joints (n,), hands at their grasps.
        T_world_goal: Object pose (4, 4).
        grasps: Left and right T_object_tcp (4, 4).
        scene: From `scene_holding`.
    """

    q_start: Array
    T_world_goal: Array
    grasps: tuple[Array, Array]
    scene: PlanningScene
    seed: int = 0


class NotFreeError(ClosedChainError, reason="not_free"):
    """Not proven."""


class HeldPlanner:
    """Plans moves of held objects. One instance per process."""

    def __init__(self, planner: Planner | None = None) -> None:
        self.planner = planner or Planner()

    def plan(self, query: HeldQuery, budget_s: float | None = None) -> CarriedTrajectory:
        """Return a proven trajectory to the goal. Equal queries give equal trajectories.

        Raises:
            PlanningError: Bad start or goal, or nothing proven within `budget_s` (NoPathInTimeError).
            UsageError: Bad query.
        """
        return HeldWork(self.planner, query, budget_s).run()

    def follow(
        self,
        q_start: Array,
        Ts_world_object: Sequence[Array],
        grasps: tuple[Array, Array],
        *,
        along: PathLimits | None = None,
        scene: PlanningScene | None = None,
    ) -> CarriedTrajectory:
        """Return the trajectory along object waypoints (4, 4), at rest at both ends.

        It is proven only with a `scene` (see `scene_holding`); `along` limits the object.

        Raises:
            NotFreeError: No proof.
            ClosedChainError, TimingError: The hands or the limits cannot follow.
            OutOfLimitsError, UsageError: Bad arguments.
        """
        q_start = check_joints(q_start, "start", self.planner.robot)
        hands = HandsIK(grasps, self.planner.robot)
        path = HeldPath.through(Ts_world_object)
        hands.require_held(q_start, path.poses(np.zeros(1))[0])
        curve = _continued(hands, path, q_start)
        motion = curve.timed(
            along or PathLimits(),
            _LIMITS,
            self.planner.kinematics,
            "continuation",
        )
        return motion if scene is None else _proven(motion, self.planner.engines(scene))


def _proven(motion: CarriedTrajectory, engines: SceneEngines) -> CarriedTrajectory:
    if not (proof := engines.verify(motion)).ok:
        raise NotFreeError(f"the carried path is not free: {proof.reason}")
    return replace(motion, verification=proof)


def _continued(hands: HandsIK, path: HeldPath, q_start: Array) -> HeldCurve:
    def solve(_marks: Array, Ts_world_object: Array) -> Array:
        joints, ended = hands.follow(Ts_world_object, q_start)
        if ended is not None:
            raise ended
        return joints

    return fine_curve(hands, path, solve)


class _Effort(NamedTuple):
    padding_m: float
    step_scale: float = 1.0
    checks_n: int = 600

    def after_no_path(self) -> _Effort:
        """Return less padding and more state checks."""
        return self._replace(
            padding_m=max(0.6 * self.padding_m, 0.001),
            checks_n=min(2 * self.checks_n, 100_000),
        )

    def after(self, error: PlanningError) -> _Effort:
        """Return finer steps, and more padding for a path that is not proven."""
        padding_m = (
            more_padding(self.padding_m)
            if isinstance(error, NotFreeError | TimingError)
            else self.padding_m
        )
        return self._replace(step_scale=max(0.5 * self.step_scale, 0.125), padding_m=padding_m)


class HeldWork:
    """One query in progress; raises as `HeldPlanner.plan`."""

    def __init__(self, planner: Planner, query: HeldQuery, budget_s: float | None = None) -> None:
        budget_s = planner.budget(budget_s)
        self._kinematics = planner.kinematics
        self._config = planner.config
        self._query = query
        self._q_start = check_joints(query.q_start, "start", planner.robot)
        self._hands = HandsIK(query.grasps, planner.robot)
        T_goal = check_pose(query.T_world_goal, "the goal of the object")
        self._engines = planner.engines(query.scene)
        self._deadline = time.perf_counter() + budget_s
        self._T_start = self._object_at(self._q_start)
        self._hands.require_held(self._q_start, self._T_start)
        require_free(self._engines, self._q_start, "start")
        self._path = HeldPath.through([self._T_start, T_goal])
        self.notes: list[str] = []

    def _object_at(self, q: Array) -> Array:
        return self._kinematics.tcp_poses(q)[0] @ inverse(self._hands.grasps[0])

    def run(self) -> CarriedTrajectory:
        """See `HeldPlanner.plan`."""
        straight = self._straight()
        if isinstance(straight, CarriedTrajectory):
            return straight
        effort = _Effort(self._config.padding_m)
        try:
            goals = self.goal_postures(straight, 1)
        except (
            PlanningError
        ):  # free postures may be rare: look longer before saying that there is none
            goals = self.goal_postures(straight, 1, max(_MORE_GOALS.values()))
        for attempt, method in enumerate(itertools.cycle(METHODS)):
            if time.perf_counter() > self._deadline:
                break
            if attempt in _MORE_GOALS:
                try:
                    goals = self.goal_postures(straight, _GOALS_N, _MORE_GOALS[attempt])
                except PlanningError as error:
                    self.notes.append(f"no more postures at the goal: {error.message}")
            try:
                if (points := self.search(method, goals, effort, attempt)) is not None:
                    rng = stream(self._query.seed, "held/shorten", attempt)
                    space = self._space([points[-1, Q]], effort)
                    return self.rounded(shorten(space, points, rng, _SHORTEN_ROUNDS_N), method)
                self.notes.append(f"{method} found no path")
                effort = effort.after_no_path()
            except (ClosedChainError, TimingError) as error:
                self.notes.append(f"{method}: {error.message}")
                effort = effort.after(error)
        tried = f"the straight way: {self.notes[0]}; {len(self.notes)} attempts, the last one: {self.notes[-1]}"
        remedy = "raise the budget, make room in the scene, or choose another goal or grasp"
        raise NoPathInTimeError(
            f"no proven path for the held object within the budget; {tried}",
            remedy=remedy,
        )

    def _straight(self) -> CarriedTrajectory | Array | None:
        end = None
        try:
            curve = _continued(self._hands, self._path, self._q_start)
            joints = curve.spline(np.linspace(0.0, curve.length, len(curve.marks)))
            end = joints[-1]
            if self._checker(end, self._config.padding_m).all_free(joints):
                return self._finished(curve, "continuation")
            self.notes.append(f"it is blocked: {self._touching(joints)}")
        except (ClosedChainError, TimingError) as error:
            self.notes.append(error.message)
        return end

    def _checker(self, q_goal: Array, padding_m: float) -> EdgeChecker:
        return EdgeChecker(
            self._engines,
            padding_m,
            (self._q_start, q_goal),
            self._config.edge_step_rad,
        )

    def _touching(self, joints: Array) -> str:
        near = [pair for q in joints for pair in self._engines.closest(q, self._config.padding_m)]
        return (
            str(min(near, key=lambda p: p.distance_m))
            if near
            else "parts come nearer than the padding"
        )

    def goal_postures(
        self,
        end: Array | None,
        wanted_n: int,
        restarts_scale: int = 1,
    ) -> list[Array]:
        """Return free goal postures (n,): the straight end first, then the nearest.

        Raises:
            IKUnreachableError, GoalInCollisionError: None exists.
            ClosedChainError: All lie at limits.
        """
        config = self._config
        engines = self._engines
        robot = self._hands.robot
        T_goal = self._query.T_world_goal
        goals = [end] if end is not None and engines.solids.free(end) else []
        roomy = bool(goals) and not engines.closest(goals[0], config.padding_m)
        if not (roomy and wanted_n == 1):
            try:
                targets = {
                    arm: T_goal @ grasp
                    for arm, grasp in zip(SIDES, self._hands.grasps, strict=True)
                }
                rng = stream(self._query.seed, "held/goals")
                most_n = 1 if wanted_n == 1 else _CANDIDATES_N
                restarts_n = restarts_scale * config.ik_restarts_n
                goals += pose_goals(
                    "both_arms",
                    self._q_start,
                    targets,
                    engines,
                    rng,
                    restarts_n,
                    most_n,
                )
            except PlanningError:
                if not goals:
                    raise
        found: list[Array] = []
        for goal in goals:
            if len(found) >= wanted_n:
                break
            inside = np.clip(goal, robot.q_lower + _LIMIT_ROOM_RAD, robot.q_upper - _LIMIT_ROOM_RAD)
            if (q := self._hands.solve(T_goal, inside)) is None:
                continue
            relaxed = self._hands.relaxed(T_goal, q)
            q = relaxed if engines.solids.free(relaxed) else q
            if all(np.abs(q - other).max() > _SAME_RAD for other in found):
                found.append(q)
        if not found:
            bent = f"every posture found for the goal at {place_text(T_goal)} lies at a joint limit"
            raise ClosedChainError(
                bent,
                remedy="move the goal nearer to the middle, or choose another grasp",
            )
        return found

    def _space(self, goals: Sequence[Array], effort: _Effort) -> HeldSpace:
        return HeldSpace(
            self._hands,
            self._path.chart,
            self._checker(goals[0], effort.padding_m),
            effort.step_scale,
        )

    def search(
        self,
        method: str,
        goals: Sequence[Array],
        effort: _Effort,
        attempt: int,
    ) -> Array | None:
        """Return points (m, 6 + n) to a goal, or None."""
        query = self._query
        space = self._space(goals, effort)
        if method == "object_rrt":
            space.checker.allow(effort.checks_n, self._deadline)
            start = space.point(self._T_start, self._q_start)
            ends = [space.point(query.T_world_goal, q) for q in goals]
            return search_object(space, start, ends, stream(query.seed, "held/search", attempt))
        left, right = self._hands.grasps
        constraint = GraspConstraint(inverse(left) @ right, self._kinematics)
        start = self._hands.solve(self._T_start, self._q_start)
        seed = subseed(query.seed, "held/manifold", attempt)
        for goal in goals[:_MANIFOLD_GOALS_N]:
            if start is None or time.perf_counter() > self._deadline:
                break
            space.checker.allow(effort.checks_n, self._deadline)
            if (
                found := search_manifold(
                    constraint,
                    space.checker,
                    start,
                    goal,
                    space=method,
                    seed=seed,
                )
            ) is not None:
                points = [space.solved_free(space.point(self._object_at(q), q)) for q in found]
                kept = [z for z in points if z is not None]
                joined = len(kept) == len(points) and all(
                    itertools.starmap(space.edge_free, itertools.pairwise(kept)),
                )
                return np.array(kept) if joined else None
        return None

    def rounded(self, points: Array, method: str) -> CarriedTrajectory:
        """Return the proven trajectory along points (m, 6 + n), with the largest feasible corners."""
        for corner_m in _CORNERS_M[:-1] if len(points) > 2 else ():
            with suppress(ClosedChainError):
                return self._finished(self._curve(points, corner_m), method)
        return self._finished(self._curve(points, _CORNERS_M[-1]), method)

    def _curve(self, points: Array, corner_m: float) -> HeldCurve:
        # Weighted as in the search metric, so that s is mostly object motion.
        scale = np.ones(points.shape[1])
        scale[Q] = JOINT_WEIGHT_M
        smooth = rounded(points * scale, corner_m)

        def solve(marks: Array, Ts_world_object: Array) -> Array:
            solved = smooth.at(marks)[:, Q] / JOINT_WEIGHT_M
            for k, T in enumerate(Ts_world_object):
                if (q := self._hands.solve(T, solved[k])) is None:
                    raise ClosedChainError(f"the hands cannot hold the object at {place_text(T)}")
                solved[k] = q
            return solved

        return fine_curve(self._hands, HeldPath(self._path.chart, smooth), solve)

    def _finished(self, curve: HeldCurve, method: str) -> CarriedTrajectory:
        return _proven(curve.timed(PathLimits(), _LIMITS, self._kinematics, method), self._engines)
