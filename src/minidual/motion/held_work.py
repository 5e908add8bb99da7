"""One query of the planner of held objects, from the straight try to the last resort."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from minidual.collision.errors import ClosedChainError, NoPathInTimeError, PlanningError, TimingError
from minidual.config.planning import PlannerConfig
from minidual.motion.blend import rounded
from minidual.motion.closed_chain import continued, require_held
from minidual.motion.constrained_search import search_manifold
from minidual.motion.edges import EdgeChecker
from minidual.motion.goals import PoseGoals, require_free
from minidual.motion.grasp_constraint import GraspConstraint
from minidual.motion.hands_ik import HandsIK
from minidual.motion.held_path import CarriedTrajectory, HeldCurve, ObjectLimits, fine_curve, timed
from minidual.motion.held_query import HeldQuery
from minidual.motion.held_search import search_object, shorten
from minidual.motion.held_space import JOINT_WEIGHT_M, HeldSpace, Q, X
from minidual.motion.object_path import ObjectPath
from minidual.motion.timing import MotionLimits
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.constants import ARMS, Q_LOWER, Q_UPPER, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import inverse

METHODS = ("object_rrt", "object_rrt", "object_rrt", "projected", "object_rrt", "object_rrt", "atlas")
"""Searches, in the order of the attempts; then from the beginning."""
_CORNERS_M = (0.06, 0.02, 0.006)
_SHORTEN_ROUNDS_N = 10
_GOALS_N = 16
_LIMIT_ROOM_RAD = 1e-4
_MANIFOLD_GOALS_N = 4
_BOX_RAD = 0.7
_MORE_GOALS = {1: 1, 2: 10}
"""Attempts before which more postures at the goal are looked for, and how many times the usual restarts. One posture is
enough for most; more cost more than the search."""
_CANDIDATES_N = 400
_SAME_RAD = 0.5
"""Postures that differ less count once."""


@dataclass(frozen=True)
class _Effort:
    """How one attempt searches, and how the next one should after a failure."""

    padding_m: float
    step_scale: float = 1.0
    checks_n: int = 600

    def after_no_path(self) -> _Effort:
        """Return more patience and less padding: the way may be narrow."""
        return replace(self, padding_m=max(0.6 * self.padding_m, 0.001), checks_n=min(2 * self.checks_n, 100_000))

    def after_refusal(self) -> _Effort:
        """Return more padding and a closer look: the path touched where the search did not see it."""
        return replace(self, padding_m=min(1.5 * self.padding_m, 0.02), step_scale=max(0.5 * self.step_scale, 0.125))


class _NotFreeError(ClosedChainError):
    """The proof refused a path."""


class HeldWork:
    """One query while it is planned.

    Args:
        query: The problem, checked.
        engines: Of its scene.
        kinematics: Workspace.
        goals: Inverse kinematics for postures at the goal.
        config: Padding and step of the search.
        limits: Limits of the joints' motion.
        object_limits: Speed and acceleration of the object.
        deadline: time.perf_counter() at which to give up.

    Raises:
        ClosedChainError: The hands are off their grasps at the start.
        StartInCollisionError: Something touches there.
    """

    def __init__(
        self,
        query: HeldQuery,
        engines: SceneEngines,
        kinematics: Kinematics,
        goals: PoseGoals,
        config: PlannerConfig,
        limits: MotionLimits,
        object_limits: ObjectLimits,
        deadline: float,
    ) -> None:
        self._query = query
        self._engines = engines
        self._kinematics = kinematics
        self._goals = goals
        self._config = config
        self._limits = limits
        self._object_limits = object_limits
        self._deadline = deadline
        self._grasps = (query.T_object_tcp_left, query.T_object_tcp_right)
        self._T_tcp_object = inverse(self._grasps[0])
        self._hands = HandsIK(*self._grasps, kinematics)
        self._T_start = kinematics.tcp_poses(query.q_start)[0] @ self._T_tcp_object
        require_held(self._hands, query.q_start, self._T_start)
        require_free(engines.mujoco, query.q_start, "start")
        self._path = ObjectPath([self._T_start, query.T_world_goal])
        self._chart = self._path.chart
        self._rejections: list[str] = []

    def run(self) -> CarriedTrajectory:
        """Return a proven trajectory; see `HeldPlanner.plan`."""
        straight = self._straight()
        if isinstance(straight, CarriedTrajectory):
            return straight
        effort = _Effort(self._config.padding_m)
        goals = self._goal_postures(straight, 1)
        for attempt, method in enumerate(itertools.cycle(METHODS)):
            if time.perf_counter() > self._deadline:
                break
            if attempt in _MORE_GOALS:
                goals = self._more_goals(goals, straight, _MORE_GOALS[attempt])
            try:
                points = self._search(method, goals, effort, attempt)
                if points is None:
                    self._rejections.append(f"{method} found no path")
                    effort = effort.after_no_path()
                    continue
                return self._finish(points, method, effort, attempt)
            except (_NotFreeError, TimingError) as error:
                self._rejections.append(f"{method}: {error.message}")
                effort = effort.after_refusal()
            except ClosedChainError as error:
                self._rejections.append(f"{method}: {error.message}")
                effort = replace(effort, step_scale=max(0.5 * effort.step_scale, 0.125))
        raise NoPathInTimeError(
            f"no proven path for the held object within the budget; the straight way: {self._rejections[0]}; "
            f"{len(self._rejections)} attempts, the last one: {self._rejections[-1]}",
            remedy="raise the budget, make room in the scene, or choose another goal or grasp",
        )

    def prove(self, points: Array) -> CarriedTrajectory:
        """Return the proven trajectory along given points (n, 20); see `HeldPlanner.prove`."""
        return self._rounded(points, "given")

    def _straight(self) -> CarriedTrajectory | Array | None:
        """Return the proven straight move; or the posture (14,) at its end if only the way is blocked; or None."""
        try:
            curve, residual_m, residual_rad = continued(self._hands, self._path, self._query.q_start)
        except ClosedChainError as error:
            self._rejections.append(error.message)
            return None
        rows = curve.at(np.linspace(0.0, curve.length, len(curve.marks)))[:, :14]
        end = rows[-1]
        if not self._checker(end, self._config.padding_m).all_free(rows):
            self._rejections.append(f"it is blocked: {self._touching(rows)}")
            return end
        try:
            return self._timed(curve, residual_m, residual_rad, "continuation")
        except (ClosedChainError, TimingError) as error:
            self._rejections.append(error.message)
            return end

    def _checker(self, q_goal: Array, padding_m: float) -> EdgeChecker:
        ends = (self._query.q_start, q_goal)
        return EdgeChecker(self._engines, padding_m, ends, self._config.edge_step_rad)

    def _touching(self, rows: Array) -> str:
        """Return which parts come nearest along configurations (n, 14)."""
        found = [
            (near[0].distance_m, str(near[0]), k)
            for k, q in enumerate(rows)
            if (near := self._engines.mujoco.closest(q, self._config.padding_m))
        ]
        if not found:
            return "parts come nearer than the padding"
        _, what, k = min(found)
        return f"{what} after {k / max(1, len(rows) - 1):.0%} of it"

    def _goal_postures(self, end: Array | None, wanted_n: int, restarts_scale: int = 1) -> list[Array]:
        """Return free postures (14,) at the goal: the end of the straight continuation first, then the nearest.

        Raises:
            IKUnreachableError, GoalInCollisionError: There is none.
            ClosedChainError: Each of them lies at a joint limit.
        """
        mujoco = self._engines.mujoco
        goals = [end] if end is not None and not mujoco.in_collision(end) else []
        roomy = bool(goals) and not mujoco.closest(goals[0], self._config.padding_m)
        if not (roomy and wanted_n == 1):
            targets = {arm: self._query.T_world_goal @ grasp for arm, grasp in zip(ARMS, self._grasps, strict=True)}
            try:
                more = self._goals.candidates(
                    "both_arms",
                    self._query.q_start,
                    targets,
                    mujoco,
                    np.random.default_rng([self._query.seed, 1]),
                    restarts_n=restarts_scale * self._config.ik_restarts_n,
                    candidates_n=1 if wanted_n == 1 else _CANDIDATES_N,
                )
            except PlanningError:
                if not goals:
                    raise
                more = []
            goals += more
        found: list[Array] = []
        for goal in goals:
            if len(found) >= wanted_n:
                break
            q = self._hands.solve(
                self._query.T_world_goal, np.clip(goal, Q_LOWER + _LIMIT_ROOM_RAD, Q_UPPER - _LIMIT_ROOM_RAD)
            )
            if q is None:
                continue
            roomy = self._hands.relaxed(self._query.T_world_goal, q)
            q = q if mujoco.in_collision(roomy) else roomy
            if all(np.abs(q - other).max() > _SAME_RAD for other in found):
                found.append(q)
        if not found:
            x, y, z = self._query.T_world_goal[:3, 3]
            raise ClosedChainError(
                f"every posture found for the goal at ({x:.3f}, {y:.3f}, {z:.3f}) m lies at a joint limit",
                remedy="move the goal nearer to the middle, or choose another grasp",
            )
        return found

    def _more_goals(self, known: list[Array], end: Array | None, restarts_scale: int) -> list[Array]:
        """Return more postures at the goal, or those that are known where a closer look finds none."""
        try:
            return self._goal_postures(end, _GOALS_N, restarts_scale)
        except PlanningError as error:
            self._rejections.append(f"no more postures at the goal: {error.message}")
            return known

    def _space(self, goals: Sequence[Array], effort: _Effort) -> HeldSpace:
        checker = self._checker(goals[0], effort.padding_m)
        return HeldSpace(self._hands, self._chart, checker, effort.step_scale)

    def _search(self, method: str, goals: Sequence[Array], effort: _Effort, attempt: int) -> Array | None:
        """Return points (n, 20) from start to goal by one method, or None."""
        query = self._query
        space = self._space(goals, effort)
        if method == "object_rrt":
            start = space.point(self._T_start, query.q_start)
            ends = [space.point(query.T_world_goal, q) for q in goals]
            rng = np.random.default_rng([query.seed, 2, attempt])
            return search_object(space, start, ends, rng, checks_max=effort.checks_n, deadline=self._deadline)
        constraint = GraspConstraint.from_grasps(*self._grasps, self._kinematics)
        configurations = search_manifold(
            constraint,
            space.checker,
            query.q_start,
            goals[:_MANIFOLD_GOALS_N],
            space=method,
            box_rad=_BOX_RAD,
            seed=query.seed + attempt,
            checks_max=effort.checks_n,
            deadline=self._deadline,
        )
        if configurations is None:
            return None
        points = np.array(
            [space.point(self._kinematics.tcp_poses(q)[0] @ self._T_tcp_object, q) for q in configurations]
        )
        return points if all(space.edge_free(a, b) for a, b in itertools.pairwise(points)) else None

    def _finish(self, points: Array, method: str, effort: _Effort, attempt: int) -> CarriedTrajectory:
        """Shorten, round, solve, time and prove.

        Raises:
            ClosedChainError, TimingError: What stopped it.
        """
        rng = np.random.default_rng([self._query.seed, 3, attempt])
        space = self._space([points[-1, Q]], effort)
        return self._rounded(shorten(space, points, rng, _SHORTEN_ROUNDS_N), method)

    def _rounded(self, points: Array, method: str) -> CarriedTrajectory:
        """Return the proven trajectory along points, with the largest corners that do."""
        for corner_m in _CORNERS_M[:-1] if len(points) > 2 else ():
            try:
                return self._timed(*self._curve(points, corner_m), method)
            except ClosedChainError:
                continue
        return self._timed(*self._curve(points, _CORNERS_M[-1]), method)

    def _curve(self, points: Array, corner_m: float) -> tuple[HeldCurve, float, float]:
        # Joints count for a tenth of a metre a radian, so that the points of the curve are dense where the object is.
        scale = np.ones(points.shape[1])
        scale[Q] = JOINT_WEIGHT_M
        smooth = rounded(points * scale, corner_m)

        def coordinates(s: Array, order: int) -> Array:
            return smooth.at(s, order)[:, X]

        def solve(marks: Array, Ts_world_object: Array) -> Array:
            seeds = smooth.at(marks)[:, Q] / JOINT_WEIGHT_M
            solved = np.empty_like(seeds)
            for k, (T, seed) in enumerate(zip(Ts_world_object, seeds, strict=True)):
                q = self._hands.solve(T, seed)
                if q is None:
                    x, y, z = T[:3, 3]
                    raise ClosedChainError(f"the hands cannot hold the object at ({x:.3f}, {y:.3f}, {z:.3f}) m")
                solved[k] = q
            return solved

        return fine_curve(self._hands, self._chart, smooth.length, smooth.knots, coordinates, solve)

    def _timed(self, curve: HeldCurve, residual_m: float, residual_rad: float, method: str) -> CarriedTrajectory:
        trajectory, poses = timed(curve, self._chart, self._object_limits, self._limits, self._kinematics)
        report = self._engines.verifier.verify(trajectory)
        if not report.ok:
            raise _NotFreeError(f"the carried path is not free: {report.reason}")
        return CarriedTrajectory(
            trajectory.times,
            trajectory.q,
            trajectory.v,
            trajectory.a,
            trajectory.group,
            poses,
            residual_m,
            residual_rad,
            report,
            method,
        )
