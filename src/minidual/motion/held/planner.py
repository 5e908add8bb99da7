"""Planning for an object held by both hands, along waypoints or to a goal.

For goals: straight motion, then RRT-Connect over object poses or OMPL on the constraint manifold.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from minidual.collision.errors import ClosedChainError, NoPathInTimeError, PlanningError, TimingError
from minidual.collision.scene import Attached, PlanningScene
from minidual.collision.shapes import Shape
from minidual.errors import UsageError
from minidual.motion.api import Planner
from minidual.motion.blend import rounded
from minidual.motion.edges import EdgeChecker
from minidual.motion.goals import check_joints, require_free
from minidual.motion.held.constraint import GraspConstraint, search_manifold
from minidual.motion.held.hands import HandsIK
from minidual.motion.held.path import (
    RESIDUAL_MAX_M,
    RESIDUAL_MAX_RAD,
    CarriedTrajectory,
    HeldCurve,
    ObjectLimits,
    ObjectPath,
    fine_curve,
    timed,
)
from minidual.motion.held.search import JOINT_WEIGHT_M, HeldSpace, Q, X, search_object, shorten
from minidual.motion.ik import check_pose
from minidual.motion.timing import MotionLimits
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array, Robot
from minidual.robot.poses import inverse

CARRY_LIMITS = MotionLimits(smoothing_s=0.1)
"""Gentler starts and stops than with empty hands."""
METHODS = ("object_rrt", "object_rrt", "object_rrt", "projected", "object_rrt", "object_rrt", "atlas")
"""Methods by attempt, cyclic."""
_CORNER_M = 0.04
_CORNERS_M = (0.06, 0.02, 0.006)
_SHORTEN_ROUNDS_N = 10
_GOALS_N = 16
_LIMIT_ROOM_RAD = 1e-4
_MANIFOLD_GOALS_N = 4
_BOX_RAD = 0.7
_MORE_GOALS = {1: 1, 2: 10}
"""{attempt: multiple of usual IK restarts} for more goal postures, which cost more than the search."""
_CANDIDATES_N = 400
_SAME_RAD = 0.5
"""Postures that differ less are duplicates."""


def grasp_of(q: Array, T_world_object: Array, kinematics: Kinematics | None = None) -> tuple[Array, Array]:
    """Return both grasps T_object_tcp at q (n,)."""
    left, right = (kinematics or Kinematics()).tcp_poses(np.asarray(q, dtype=float))
    T_object_world = inverse(T_world_object)
    return T_object_world @ left, T_object_world @ right


def scene_holding(
    scene: PlanningScene, shape: Shape, T_object_tcp_left: Array, *, rests_on: Sequence[str] = ("table",)
) -> PlanningScene:
    """Return the scene with `shape` (placed in the object frame) attached to the left tcp.

    The object may touch the hands and `rests_on`.
    """
    T_tcp_shape = inverse(T_object_tcp_left) @ shape.T_parent_shape
    x, y, z, w = pin.Quaternion(T_tcp_shape[:3, :3]).coeffs().tolist()
    held = replace(shape, position_m=tuple(T_tcp_shape[:3, 3].tolist()), quat_wxyz=(w, x, y, z))
    hands = tuple(link for side in SIDES for link in scene.robot.hand_links(side))
    scene = scene.with_attached(Attached(held, scene.robot.tcp_names[0], hands))
    for obstacle in rests_on:
        scene = scene.allowing(shape.name, obstacle, "the object is lifted off it and put down on it")
    return scene


@dataclass(frozen=True, eq=False)
class HeldQuery:
    """One planning problem.

    Attributes:
        q_start: All joints (n,), hands at their grasps.
        T_world_goal: Object pose (4, 4).
        T_object_tcp_left, T_object_tcp_right: Grasps (4, 4).
        scene: From `scene_holding`.
    """

    q_start: Array
    T_world_goal: Array
    T_object_tcp_left: Array
    T_object_tcp_right: Array
    scene: PlanningScene
    seed: int = 0

    def checked(self, robot: Robot) -> HeldQuery:
        """Return the checked query.

        Raises:
            OutOfLimitsError, UsageError: Bad query.
        """
        return replace(
            self,
            q_start=check_joints(self.q_start, "start", robot),
            T_world_goal=check_pose(self.T_world_goal, "the goal of the object"),
            T_object_tcp_left=check_pose(self.T_object_tcp_left, "the left grasp"),
            T_object_tcp_right=check_pose(self.T_object_tcp_right, "the right grasp"),
        )


class HeldPlanner:
    """Plans moves of held objects. One instance per process; it holds workspaces."""

    def __init__(
        self,
        planner: Planner | None = None,
        *,
        limits: MotionLimits | None = None,
        object_limits: ObjectLimits | None = None,
    ) -> None:
        self.planner = planner or Planner()
        self.config = self.planner.config
        self.engines = self.planner.engines
        self.limits = limits or CARRY_LIMITS
        self.object_limits = object_limits or ObjectLimits()
        self.kinematics = self.planner.kinematics
        self.goals = self.planner.goals

    def plan(self, query: HeldQuery, budget_s: float | None = None) -> CarriedTrajectory:
        """Return a proven trajectory to the goal. Equal queries give equal trajectories.

        Raises:
            ClosedChainError: Hands off their grasps, or goal postures at joint limits.
            StartInCollisionError, GoalInCollisionError: Start or goal postures collide.
            IKUnreachableError: The goal is out of reach.
            NoPathInTimeError: Nothing proven within `budget_s`.
            OutOfLimitsError, UsageError: Bad query.
        """
        budget = self.config.budget_s if budget_s is None else budget_s
        if not (np.isfinite(budget) and budget > 0.0):
            raise UsageError(f"budget_s = {budget}; it must be a finite number > 0")
        query = query.checked(self.planner.robot)
        self.planner.engines(query.scene)  # built before the budget runs
        return HeldWork(self, query, time.perf_counter() + budget).run()

    def prove(self, query: HeldQuery, points: Array) -> CarriedTrajectory:
        """Return the proven trajectory along points (m, 6 + n) in the chart of the start orientation.

        Raises:
            ClosedChainError, TimingError: It cannot be followed, timed or proven.
            StartInCollisionError, OutOfLimitsError, UsageError: Bad query.
        """
        return HeldWork(self, query.checked(self.planner.robot), time.perf_counter() + self.config.budget_s).rounded(
            points, "given"
        )

    def follow(
        self,
        q_start: Array,
        Ts_world_object: Sequence[Array],
        T_object_tcp_left: Array,
        T_object_tcp_right: Array,
        *,
        object_limits: ObjectLimits | None = None,
        scene: PlanningScene | None = None,
        corner_m: float = _CORNER_M,
    ) -> CarriedTrajectory:
        """Return the trajectory along object waypoints (4, 4), at rest at both ends.

        Collisions are checked only with a `scene` (see `scene_holding`).

        Raises:
            ClosedChainError: Bad start, hand out of reach, jump, error over 0.05 mm or 0.025 degrees, or no proof.
            TimingError: The limits cannot be kept.
            OutOfLimitsError, UsageError: Bad arguments.
        """
        q_start = check_joints(q_start, "start", self.planner.robot)
        grasps = (check_pose(T_object_tcp_left, "the left grasp"), check_pose(T_object_tcp_right, "the right grasp"))
        hands = HandsIK(*grasps, self.kinematics)
        path = ObjectPath(Ts_world_object, corner_m)
        _require_held(hands, q_start, path.poses(np.zeros(1))[0])
        curve = _continued(hands, path, q_start)
        motion = timed(curve, object_limits or self.object_limits, self.limits, self.kinematics, "continuation")
        return motion if scene is None else proven(motion, self.engines(scene))


class _NotFreeError(ClosedChainError):
    """The proof failed."""


def proven(motion: CarriedTrajectory, engines: SceneEngines) -> CarriedTrajectory:
    """Return the trajectory with its proof.

    Raises:
        ClosedChainError: The proof failed.
    """
    report = engines.verifier.verify(motion)
    if not report.ok:
        raise _NotFreeError(f"the carried path is not free: {report.reason}")
    return replace(motion, verification=report)


def _require_held(hands: HandsIK, q: Array, T_world_object: Array) -> None:
    """Raise ClosedChainError if a hand is off its grasp."""
    for arm, (distance, angle) in zip(SIDES, hands.off_grasp(q, T_world_object), strict=True):
        if not (distance <= RESIDUAL_MAX_M and angle <= RESIDUAL_MAX_RAD):
            raise ClosedChainError(
                f"at the start the {arm} hand is {distance * 1e3:.2f} mm and {angle:.4f} rad off its grasp",
                remedy="take the grasps from the hands as they are (grasp_of), or solve the start first",
            )


def _continued(hands: HandsIK, path: ObjectPath, q_start: Array) -> HeldCurve:
    """Return the curve along an object path from q_start (n,), or raise ClosedChainError."""

    def solve(_marks: Array, Ts_world_object: Array) -> Array:
        joints, stuck = hands.follow(Ts_world_object, q_start)
        if stuck is not None:
            raise stuck
        return joints

    return fine_curve(hands, path.chart, path.length, path.knots, path.coordinates, solve)


@dataclass(frozen=True)
class _Effort:
    padding_m: float
    step_scale: float = 1.0
    checks_n: int = 600

    def after_no_path(self) -> _Effort:
        """Return less padding and more state checks."""
        return replace(self, padding_m=max(0.6 * self.padding_m, 0.001), checks_n=min(2 * self.checks_n, 100_000))

    def closer(self) -> _Effort:
        """Return finer steps: the path could not be followed."""
        return replace(self, step_scale=max(0.5 * self.step_scale, 0.125))

    def after_refusal(self) -> _Effort:
        """Return more padding (up to 0.02 m) and finer steps."""
        return replace(self.closer(), padding_m=min(1.5 * self.padding_m, 0.02))


class HeldWork:
    """One query in progress.

    Raises:
        ClosedChainError: Hands off their grasps.
        StartInCollisionError: The start collides.
    """

    def __init__(self, tools: HeldPlanner, query: HeldQuery, deadline: float) -> None:
        self._tools = tools
        self._query = query
        self._deadline = deadline
        self._engines = tools.engines(query.scene)
        self._grasps = (query.T_object_tcp_left, query.T_object_tcp_right)
        self._hands = HandsIK(*self._grasps, tools.kinematics)
        self._T_start = self._object_at(query.q_start)
        _require_held(self._hands, query.q_start, self._T_start)
        require_free(self._engines, query.q_start, "start")
        self._path = ObjectPath([self._T_start, query.T_world_goal])
        self.rejections: list[str] = []

    def _object_at(self, q: Array) -> Array:
        """Return the object pose in the left hand."""
        return self._tools.kinematics.tcp_poses(q)[0] @ inverse(self._grasps[0])

    def run(self) -> CarriedTrajectory:
        """See `HeldPlanner.plan`."""
        straight = self._straight()
        if isinstance(straight, CarriedTrajectory):
            return straight
        effort = _Effort(self._tools.config.padding_m)
        goals = self.goal_postures(straight, 1)
        for attempt, method in enumerate(itertools.cycle(METHODS)):
            if time.perf_counter() > self._deadline:
                break
            if attempt in _MORE_GOALS:
                goals = self.more_goals(goals, straight, _MORE_GOALS[attempt])
            try:
                points = self.search(method, goals, effort, attempt)
                if points is not None:
                    rng = np.random.default_rng([self._query.seed, 3, attempt])
                    space = self._space([points[-1, Q]], effort)
                    return self.rounded(shorten(space, points, rng, _SHORTEN_ROUNDS_N), method)
                self.rejections.append(f"{method} found no path")
                effort = effort.after_no_path()
            except (ClosedChainError, TimingError) as error:
                self.rejections.append(f"{method}: {error.message}")
                refused = isinstance(error, _NotFreeError | TimingError)
                effort = effort.after_refusal() if refused else effort.closer()
        raise NoPathInTimeError(
            f"no proven path for the held object within the budget; the straight way: {self.rejections[0]}; "
            f"{len(self.rejections)} attempts, the last one: {self.rejections[-1]}",
            remedy="raise the budget, make room in the scene, or choose another goal or grasp",
        )

    def _straight(self) -> CarriedTrajectory | Array | None:
        """Return the proven straight move, else its end posture (n,), else None."""
        end = None
        try:
            curve = _continued(self._hands, self._path, self._query.q_start)
            joints = curve.spline(np.linspace(0.0, curve.length, len(curve.marks)))
            end = joints[-1]
            if self._checker(end, self._tools.config.padding_m).all_free(joints):
                return self._finished(curve, "continuation")
            self.rejections.append(f"it is blocked: {self._touching(joints)}")
        except (ClosedChainError, TimingError) as error:
            self.rejections.append(error.message)
        return end

    def _checker(self, q_goal: Array, padding_m: float) -> EdgeChecker:
        ends = (self._query.q_start, q_goal)
        return EdgeChecker(self._engines, padding_m, ends, self._tools.config.edge_step_rad)

    def _touching(self, joints: Array) -> str:
        """Return which parts come nearest along joints (m, n)."""
        found = [
            (near[0].distance_m, str(near[0]), k)
            for k, q in enumerate(joints)
            if (near := self._engines.closest(q, self._tools.config.padding_m))
        ]
        if not found:
            return "parts come nearer than the padding"
        _, what, k = min(found)
        return f"{what} after {k / max(1, len(joints) - 1):.0%} of it"

    def goal_postures(self, end: Array | None, wanted_n: int, restarts_scale: int = 1) -> list[Array]:
        """Return free goal postures (n,): the straight end first, then the nearest.

        Raises:
            IKUnreachableError, GoalInCollisionError: None exists.
            ClosedChainError: All lie at limits.
        """
        query, config, engines, robot = self._query, self._tools.config, self._engines, self._hands.robot
        goals = [end] if end is not None and not engines.in_collision(end) else []
        roomy = bool(goals) and not engines.closest(goals[0], config.padding_m)
        if not (roomy and wanted_n == 1):
            try:
                goals += self._tools.goals.candidates(
                    "both_arms",
                    query.q_start,
                    {arm: query.T_world_goal @ grasp for arm, grasp in zip(SIDES, self._grasps, strict=True)},
                    engines,
                    np.random.default_rng([query.seed, 1]),
                    restarts_n=restarts_scale * config.ik_restarts_n,
                    candidates_n=1 if wanted_n == 1 else _CANDIDATES_N,
                )
            except PlanningError:
                if not goals:
                    raise
        found: list[Array] = []
        for goal in goals:
            if len(found) >= wanted_n:
                break
            inside = np.clip(goal, robot.q_lower + _LIMIT_ROOM_RAD, robot.q_upper - _LIMIT_ROOM_RAD)
            q = self._hands.solve(query.T_world_goal, inside)
            if q is None:
                continue
            relaxed = self._hands.relaxed(query.T_world_goal, q)
            q = q if engines.in_collision(relaxed) else relaxed
            if all(np.abs(q - other).max() > _SAME_RAD for other in found):
                found.append(q)
        if not found:
            x, y, z = query.T_world_goal[:3, 3]
            raise ClosedChainError(
                f"every posture found for the goal at ({x:.3f}, {y:.3f}, {z:.3f}) m lies at a joint limit",
                remedy="move the goal nearer to the middle, or choose another grasp",
            )
        return found

    def more_goals(self, known: list[Array], end: Array | None, restarts_scale: int) -> list[Array]:
        """Return more goal postures, or the known ones."""
        try:
            return self.goal_postures(end, _GOALS_N, restarts_scale)
        except PlanningError as error:
            self.rejections.append(f"no more postures at the goal: {error.message}")
            return known

    def _space(self, goals: Sequence[Array], effort: _Effort) -> HeldSpace:
        checker = self._checker(goals[0], effort.padding_m)
        return HeldSpace(self._hands, self._path.chart, checker, effort.step_scale)

    def search(self, method: str, goals: Sequence[Array], effort: _Effort, attempt: int) -> Array | None:
        """Return points (m, 6 + n) to a goal, or None."""
        query = self._query
        space = self._space(goals, effort)
        if method == "object_rrt":
            start = space.point(self._T_start, query.q_start)
            ends = [space.point(query.T_world_goal, q) for q in goals]
            rng = np.random.default_rng([query.seed, 2, attempt])
            return search_object(space, start, ends, rng, checks_max=effort.checks_n, deadline=self._deadline)
        configurations = search_manifold(
            GraspConstraint.from_grasps(*self._grasps, self._tools.kinematics),
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
        points = np.array([space.point(self._object_at(q), q) for q in configurations])
        return points if all(space.edge_free(a, b) for a, b in itertools.pairwise(points)) else None

    def rounded(self, points: Array, method: str) -> CarriedTrajectory:
        """Return the proven trajectory along points (m, 6 + n), with the largest feasible corners."""
        for corner_m in _CORNERS_M[:-1] if len(points) > 2 else ():
            try:
                return self._finished(self._curve(points, corner_m), method)
            except ClosedChainError:
                continue
        return self._finished(self._curve(points, _CORNERS_M[-1]), method)

    def _curve(self, points: Array, corner_m: float) -> HeldCurve:
        # Weighted as in the search metric, so that s is mostly object motion.
        scale = np.ones(points.shape[1])
        scale[Q] = JOINT_WEIGHT_M
        smooth = rounded(points * scale, corner_m)

        def coordinates(s: Array, order: int) -> Array:
            return smooth.at(s, order)[:, X]

        def solve(marks: Array, Ts_world_object: Array) -> Array:
            solved = smooth.at(marks)[:, Q] / JOINT_WEIGHT_M
            for k, T in enumerate(Ts_world_object):
                q = self._hands.solve(T, solved[k])
                if q is None:
                    x, y, z = T[:3, 3]
                    raise ClosedChainError(f"the hands cannot hold the object at ({x:.3f}, {y:.3f}, {z:.3f}) m")
                solved[k] = q
            return solved

        return fine_curve(self._hands, self._path.chart, smooth.length, smooth.knots, coordinates, solve)

    def _finished(self, curve: HeldCurve, method: str) -> CarriedTrajectory:
        tools = self._tools
        return proven(timed(curve, tools.object_limits, tools.limits, tools.kinematics, method), self._engines)
