"""Planning for an object held by both hands, along waypoints or to a goal."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple, Unpack

import numpy as np

from minidual.collision.errors import (
    ClosedChainError,
    NoPathInTimeError,
    PlanningError,
    TimingError,
)
from minidual.collision.scene import PlanningScene
from minidual.config.planning import MotionLimits
from minidual.config.seeds import stream, subseed
from minidual.motion.api import Planner, more_padding
from minidual.motion.blend import rounded
from minidual.motion.budget import ATTEMPT_CHECKS_N, BudgetOptions
from minidual.motion.checks import check_joints, check_pose, place_text, require_free
from minidual.motion.held.constraint import GraspConstraint, search_manifold
from minidual.motion.held.goals import GoalSearch
from minidual.motion.held.hands import HandsIK
from minidual.motion.held.path import CarriedTrajectory, HeldCurve, HeldPath, fine_curve
from minidual.motion.held.query import HeldQuery
from minidual.motion.held.search import search_object, shorten
from minidual.motion.held.space import JOINT_WEIGHT_M, HeldSpace, Q
from minidual.motion.search import EdgeChecker
from minidual.motion.timing import PathLimits
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.pair import Array, inverse

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
_MANIFOLD_GOALS_N = 4
_MORE_GOALS = {1: 1, 2: 10}
"""Attempts that first look for more goal postures: {attempt: multiple of the usual IK restarts}."""


class NotFreeError(ClosedChainError, reason="not_free"):
    """Not proven."""


class HeldPlanner:
    """Plans moves of held objects. One instance per process."""

    def __init__(self, planner: Planner | None = None) -> None:
        self.planner = planner or Planner()

    def plan(self, query: HeldQuery, **limits: Unpack[BudgetOptions]) -> CarriedTrajectory:
        """Return a proven trajectory to the goal. Equal queries give equal trajectories.

        Raises:
            PlanningError: Bad start or goal, or nothing proven within the budget
                (NoPathInTimeError).
            UsageError: Bad query.
        """
        return HeldWork(self.planner, query, **limits).run()

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
        object_limits = along or PathLimits()
        motion = curve.timed(object_limits, _LIMITS, self.planner.kinematics, "continuation")
        if scene is None:
            return motion
        return _proven(motion, self.planner.engines(scene))


def _proven(motion: CarriedTrajectory, engines: SceneEngines) -> CarriedTrajectory:
    proof = engines.verify(motion)
    if not proof.ok:
        raise NotFreeError(f"the carried path is not free: {proof.reason}")
    return replace(motion, verification=proof)


def _continued(hands: HandsIK, path: HeldPath, q_start: Array) -> HeldCurve:
    """Return the curve along which the hands follow the path from q_start (n,)."""

    def solve(_marks: Array, Ts_world_object: Array) -> Array:
        followed = hands.follow(Ts_world_object, q_start)
        if followed.error is not None:
            raise followed.error
        return followed.Q

    return fine_curve(hands, path, solve)


class Effort(NamedTuple):
    """Settings of the next attempt: padding, scale of the check steps, state checks."""

    padding_m: float
    step_scale: float = 1.0
    checks_n: int = 600

    def after_no_path(self) -> Effort:
        """Return less padding and more state checks."""
        return self._replace(
            padding_m=max(0.6 * self.padding_m, 0.001),
            checks_n=min(2 * self.checks_n, 100_000),
        )

    def after(self, error: PlanningError) -> Effort:
        """Return finer steps, and more padding for a path that is not proven."""
        padding_m = self.padding_m
        if isinstance(error, NotFreeError | TimingError):
            padding_m = more_padding(padding_m)
        return self._replace(step_scale=max(0.5 * self.step_scale, 0.125), padding_m=padding_m)


class HeldWork:
    """One query in progress; raises as `HeldPlanner.plan`."""

    def __init__(
        self,
        planner: Planner,
        query: HeldQuery,
        **limits: Unpack[BudgetOptions],
    ) -> None:
        self._kinematics = planner.kinematics
        self._config = planner.config
        q_start = check_joints(query.q_start, "start", planner.robot)
        self._query = query._replace(q_start=q_start)
        self._q_start = q_start
        self._hands = HandsIK(query.grasps, planner.robot)
        T_goal = check_pose(query.T_world_goal, "the goal of the object")
        self._engines = planner.engines(query.scene)
        self._budget = planner.budget(**limits)
        self._T_start = self._object_at(q_start)
        self._hands.require_held(q_start, self._T_start)
        require_free(self._engines, q_start, "start")
        self._path = HeldPath.through([self._T_start, T_goal])
        self.goals = GoalSearch(self._query, self._hands, self._engines, planner.config)
        self.notes: list[str] = []

    def _object_at(self, q: Array) -> Array:
        return self._kinematics.tcp_poses(q)[0] @ inverse(self._hands.grasps[0])

    def run(self) -> CarriedTrajectory:
        """See `HeldPlanner.plan`."""
        straight = self._straight()
        if isinstance(straight, CarriedTrajectory):
            return straight
        effort = Effort(self._config.padding_m)
        goals = self._first_goals(straight)
        for attempt, method in enumerate(itertools.cycle(METHODS)):
            if self._budget.ended:
                break
            self._budget.spend(ATTEMPT_CHECKS_N)
            if attempt in _MORE_GOALS:
                goals = self._more_goals(straight, _MORE_GOALS[attempt], goals)
            try:
                motion = self._attempt(method, goals, effort, attempt)
            except (ClosedChainError, TimingError) as error:
                self.notes.append(f"{method}: {error.message}")
                effort = effort.after(error)
                continue
            if motion is not None:
                return motion
            self.notes.append(f"{method} found no path")
            effort = effort.after_no_path()
        raise NoPathInTimeError(
            f"no proven path for the held object in {self._budget}; the straight way:"
            f" {self.notes[0]}; {len(self.notes)} attempts, the last one: {self.notes[-1]}",
            remedy="raise the budget, make room in the scene, or choose another goal or grasp",
        )

    def _straight(self) -> CarriedTrajectory | Array | None:
        """Return the proven straight motion, or the posture (n,) where it ends, or None."""
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

    def _first_goals(self, straight_end: Array | None) -> list[Array]:
        try:
            return self.goals.postures(straight_end, 1)
        except PlanningError:
            # Free postures may be rare: look longer before saying that there is none.
            return self.goals.postures(straight_end, 1, max(_MORE_GOALS.values()))

    def _more_goals(
        self,
        straight_end: Array | None,
        restarts_scale: int,
        goals: list[Array],
    ) -> list[Array]:
        try:
            return self.goals.postures(straight_end, _GOALS_N, restarts_scale)
        except PlanningError as error:
            self.notes.append(f"no more postures at the goal: {error.message}")
            return goals

    def _attempt(
        self,
        method: str,
        goals: Sequence[Array],
        effort: Effort,
        attempt: int,
    ) -> CarriedTrajectory | None:
        """Return a proven trajectory, or None if the method finds no path."""
        points = self.search(method, goals, effort, attempt)
        if points is None:
            return None
        rng = stream(self._query.seed, "held/shorten", attempt)
        space = self._space([points[-1, Q]], effort)
        return self.rounded(shorten(space, points, rng, _SHORTEN_ROUNDS_N), method)

    def _checker(self, q_goal: Array, padding_m: float) -> EdgeChecker:
        ends = (self._q_start, q_goal)
        return EdgeChecker(self._engines, padding_m, ends, self._config.edge_step_rad)

    def _touching(self, joints: Array) -> str:
        """Return the nearest pair on a path (m, n) for messages."""
        near = [pair for q in joints for pair in self._engines.closest(q, self._config.padding_m)]
        if not near:
            return "parts come nearer than the padding"
        return str(min(near, key=lambda pair: pair.distance_m))

    def _space(self, goals: Sequence[Array], effort: Effort) -> HeldSpace:
        checker = self._checker(goals[0], effort.padding_m)
        return HeldSpace(self._hands, self._path.chart, checker, effort.step_scale)

    def search(
        self,
        method: str,
        goals: Sequence[Array],
        effort: Effort,
        attempt: int,
    ) -> Array | None:
        """Return points (m, 6 + n) to a goal (n,), or None."""
        query = self._query
        space = self._space(goals, effort)
        if method != "object_rrt":
            return self._search_manifold(space, method, goals, effort, attempt)
        space.checker.allow(effort.checks_n, self._budget)
        start = space.point(self._T_start, self._q_start)
        ends = [space.point(query.T_world_goal, q) for q in goals]
        return search_object(space, start, ends, stream(query.seed, "held/search", attempt))

    def _search_manifold(
        self,
        space: HeldSpace,
        method: str,
        goals: Sequence[Array],
        effort: Effort,
        attempt: int,
    ) -> Array | None:
        """Return points (m, 6 + n) from OMPL's search in a constrained state space, or None."""
        left, right = self._hands.grasps
        constraint = GraspConstraint(inverse(left) @ right, self._kinematics)
        start = self._hands.solve(self._T_start, self._q_start)
        seed = subseed(self._query.seed, "held/manifold", attempt)
        for goal in goals[:_MANIFOLD_GOALS_N]:
            if start is None or self._budget.ended:
                break
            space.checker.allow(effort.checks_n, self._budget)
            path = search_manifold(
                constraint,
                space.checker,
                start,
                goal,
                space=method,
                seed=seed,
            )
            if path is not None:
                return self._projected(space, path)
        return None

    def _projected(self, space: HeldSpace, path: Array) -> Array | None:
        """Return the points (m, 6 + n) of joints (m, n), None unless all are joined by edges."""
        points = [space.solved_free(space.point(self._object_at(q), q)) for q in path]
        solved = [z for z in points if z is not None]
        if len(solved) < len(points):
            return None
        if not all(itertools.starmap(space.edge_free, itertools.pairwise(solved))):
            return None
        return np.array(solved)

    def rounded(self, points: Array, method: str) -> CarriedTrajectory:
        """Return the proven trajectory along points (m, 6 + n).

        Its corners are the largest feasible ones.
        """
        *large_corners_m, smallest_m = _CORNERS_M
        if len(points) > 2:
            for corner_m in large_corners_m:
                with suppress(ClosedChainError):
                    return self._finished(self._curve(points, corner_m), method)
        return self._finished(self._curve(points, smallest_m), method)

    def _curve(self, points: Array, corner_m: float) -> HeldCurve:
        # Weighted as in the search metric, so that s is mostly object motion.
        scale = np.ones(points.shape[1])
        scale[Q] = JOINT_WEIGHT_M
        smooth = rounded(points * scale, corner_m)

        def solve(marks: Array, Ts_world_object: Array) -> Array:
            joints = smooth.at(marks)[:, Q] / JOINT_WEIGHT_M
            for k, T in enumerate(Ts_world_object):
                q = self._hands.solve(T, joints[k])
                if q is None:
                    raise ClosedChainError(f"the hands cannot hold the object at {place_text(T)}")
                joints[k] = q
            return joints

        return fine_curve(self._hands, HeldPath(self._path.chart, smooth), solve)

    def _finished(self, curve: HeldCurve, method: str) -> CarriedTrajectory:
        motion = curve.timed(PathLimits(), _LIMITS, self._kinematics, method)
        return _proven(motion, self._engines)
