"""From a goal to a proven trajectory."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from minidual.collision.errors import NoPathInTimeError, PlanningError, TimingError
from minidual.collision.scene import PlanningScene
from minidual.config.planning import PlannerConfig
from minidual.errors import UsageError
from minidual.motion.blend import blended_path
from minidual.motion.edges import EdgeChecker
from minidual.motion.goals import PoseGoals, check_joints, goal_joints, group_arms, require_free
from minidual.motion.result import PhaseTimes, PlanResult
from minidual.motion.search import search
from minidual.motion.shortcut import shortcut
from minidual.motion.timing import DT_S, MotionLimits, time_path
from minidual.proof.certificate import certify
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.arms import DUAL_PANDA
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot
from minidual.robot.trajectory import Trajectory

_SCENES_KEPT = 8
_SAME_RAD = 1e-9
_TRIES_OF_FIRST = 4
_CHECKS_MAX = 10_000_000
_PATIENCE = 1.5
"""Search times are heavy-tailed: several short searches beat one long one."""


@dataclass(frozen=True)
class _Effort:
    padding_m: float
    step_rad: float
    checks_n: int
    fruitless_n: int = 0

    def after_no_path(self) -> _Effort:
        """Return less padding (narrow passages) and more state checks."""
        return replace(
            self,
            padding_m=0.5 * self.padding_m,
            checks_n=min(int(_PATIENCE * self.checks_n), max(self.checks_n, _CHECKS_MAX)),
            fruitless_n=self.fruitless_n + 1,
        )

    def planner(self, first: str, fallbacks: Sequence[str]) -> str:
        """Return the first planner for four failed searches, then the fallbacks in turn."""
        turn = self.fruitless_n - _TRIES_OF_FIRST
        return fallbacks[turn % len(fallbacks)] if turn >= 0 and fallbacks else first

    def after_refusal(self) -> _Effort:
        """Return more padding (up to 0.02 m) and finer steps."""
        return replace(self, padding_m=min(1.5 * self.padding_m, 0.02), step_rad=max(0.5 * self.step_rad, 0.004))


_LOADED: list[bool] = []


def _load_kernels(engines: SceneEngines) -> None:
    """Load the planes' machine code (0.3 s; 30 s if compiled) outside planning budgets."""
    home = engines.solids.robot.home
    still = np.zeros((2, len(home)))
    EdgeChecker(engines, 0.0, [home], 0.1).edge_free(home, home + 0.1)
    certify(engines.solids, Trajectory(np.array([0.0, DT_S]), still + home, still, still, "both_arms"))
    _LOADED.append(True)


class Planner:
    """Plans for left_arm, right_arm and both_arms. One instance per process; it holds workspaces.

    `scene` is the default scene. Equal queries with equal seeds give equal trajectories.

    Example:
        planner = Planner()
        result = planner.plan_to_joints("left_arm", HOME, goal, seed=1)
        q, v, a = result.trajectory.sample(0.5)
    """

    def __init__(
        self, scene: PlanningScene | None = None, config: PlannerConfig | None = None, *, robot: Robot = DUAL_PANDA
    ) -> None:
        self.config = config or PlannerConfig()
        self.scene = scene or PlanningScene(robot=robot)
        self.robot = self.scene.robot
        self.kinematics = Kinematics(self.robot)
        self.goals = PoseGoals(self.kinematics)
        self._engines: OrderedDict[PlanningScene, SceneEngines] = OrderedDict()
        config = self.config
        self.limits = MotionLimits(
            velocity_scale=config.velocity_scale,
            acceleration_scale=config.acceleration_scale,
            torque_scale=config.torque_scale,
            jerk_scale=config.jerk_scale,
            smoothing_s=config.smoothing_s,
        )

    def engines(self, scene: PlanningScene | None = None) -> SceneEngines:
        """Return a scene's engines; the last eight scenes are cached.

        Raises:
            UsageError: The scene has another robot.
        """
        scene = scene or self.scene
        if scene.robot != self.robot:
            raise UsageError(f"the planner is for two {self.robot.arm.name}, the scene for two {scene.robot.arm.name}")
        if scene not in self._engines:
            engines = self._engines[scene] = SceneEngines(scene, self.config.verify_step_rad)
            if not _LOADED:
                _load_kernels(engines)
            while len(self._engines) > _SCENES_KEPT:
                self._engines.popitem(last=False)
        self._engines.move_to_end(scene)
        return self._engines[scene]

    def plan_to_joints(
        self,
        group: str,
        q_start: Array,
        q_goal: Array,
        *,
        scene: PlanningScene | None = None,
        seed: int = 0,
        budget_s: float | None = None,
    ) -> PlanResult:
        """Plan to all joints or the group's [rad]; the other arm stands still.

        Raises:
            OutOfLimitsError, StartInCollisionError, GoalInCollisionError: Bad start or goal.
            NoPathInTimeError: Nothing proven within `budget_s`.
            UsageError: Bad group or budget, or a goal that moves the other arm.
        """
        if not _LOADED:
            self.engines(scene)  # before the clock starts: no budget pays for loading machine code
        times = PhaseTimes()
        group_arms(group)
        q_start = check_joints(q_start, "start", self.robot)
        goal = goal_joints(group, q_start, q_goal, self.robot)
        engines = self._ready(scene, times, q_start)
        require_free(engines, goal, "goal")
        return self._plan(group, q_start, [goal], engines, seed, self._budget(budget_s), times)

    def plan_to_poses(
        self,
        group: str,
        q_start: Array,
        targets: Mapping[str, Array],
        *,
        scene: PlanningScene | None = None,
        seed: int = 0,
        budget_s: float | None = None,
    ) -> PlanResult:
        """Plan to tcp poses {arm: T_world_tcp} of exactly the group's arms.

        Raises:
            IKUnreachableError: A pose is out of reach.
            And what `plan_to_joints` raises.
        """
        if not _LOADED:
            self.engines(scene)  # before the clock starts: no budget pays for loading machine code
        times = PhaseTimes()
        group_arms(group)
        q_start = check_joints(q_start, "start", self.robot)
        engines = self._ready(scene, times, q_start)
        with times.phase("ik"):
            goals = self.goals.candidates(
                group,
                q_start,
                targets,
                engines,
                np.random.default_rng([seed, 1]),
                restarts_n=self.config.ik_restarts_n,
                candidates_n=self.config.goal_candidates_n,
            )
        return self._plan(group, q_start, goals, engines, seed, self._budget(budget_s), times)

    def _ready(self, scene: PlanningScene | None, times: PhaseTimes, q_start: Array) -> SceneEngines:
        with times.phase("scene"):
            engines = self.engines(scene)
        require_free(engines, q_start, "start")
        return engines

    def _budget(self, budget_s: float | None) -> float:
        budget = self.config.budget_s if budget_s is None else budget_s
        if not (np.isfinite(budget) and budget > 0.0):
            raise UsageError(f"budget_s = {budget}; it must be a finite number > 0")
        return budget

    def _plan(
        self,
        group: str,
        q_start: Array,
        goals: Sequence[Array],
        engines: SceneEngines,
        seed: int,
        budget_s: float,
        times: PhaseTimes,
    ) -> PlanResult:
        config = self.config
        effort = _Effort(config.padding_m, config.edge_step_rad, config.search_checks_n)
        rejections: list[str] = []
        attempt = 0
        while times.elapsed_s < budget_s:
            goal = goals[attempt % len(goals)]
            key = np.random.SeedSequence([seed, 2, attempt])
            attempt += 1
            try:
                path, checker = self._search(group, q_start, goal, engines, effort, key, times, budget_s)
                if path is None:
                    name = effort.planner(config.planner, config.fallback_planners)
                    rejections.append(f"{name} found no path in {checker.checks_n} state checks")
                    effort = effort.after_no_path()
                    continue
                trajectory, path = self._finish(group, path, checker, key, times)
            except TimingError as error:
                rejections.append(error.message)
                effort = effort.after_refusal()
                continue
            with times.phase("verify"):
                verification = engines.verifier.verify(trajectory)
            if verification.ok:
                return PlanResult(
                    trajectory,
                    path,
                    goal,
                    verification,
                    dict(times.seconds),
                    times.elapsed_s,
                    attempt,
                    direct=len(path) == 2,
                    rejections=tuple(rejections),
                )
            rejections.append(f"proof failed: {verification.reason}")
            effort = effort.after_refusal()
        last = rejections[-1] if rejections else "the budget ended before the first attempt"
        raise NoPathInTimeError(
            f"no proven path for {group} in {budget_s:.2f} s: {attempt} attempts, the last one: {last}",
            remedy="raise the budget, make room in the scene, or choose another goal",
        )

    def _search(
        self,
        group: str,
        q_start: Array,
        goal: Array,
        engines: SceneEngines,
        effort: _Effort,
        key: np.random.SeedSequence,
        times: PhaseTimes,
        budget_s: float,
    ) -> tuple[Array | None, EdgeChecker]:
        """Return a free polyline (k, n) or None, and its checker."""
        with times.phase("search"):
            # All pairs were checked at start and goal; only pairs with a moving part can change.
            checker = EdgeChecker(engines, effort.padding_m, (q_start, goal), effort.step_rad, group_arms(group))
            if checker.edge_free(q_start, goal):
                return np.array([q_start, goal]), checker
            path = search(
                checker,
                q_start,
                goal,
                self.robot.groups[group],
                planner=effort.planner(self.config.planner, self.config.fallback_planners),
                range_rad=self.config.range_rad,
                seed=int(key.generate_state(1)[0]),
                checks_max=effort.checks_n,
                deadline=times.started + budget_s,
            )
        return path, checker

    def _finish(
        self, group: str, path: Array, checker: EdgeChecker, key: np.random.SeedSequence, times: PhaseTimes
    ) -> tuple[Trajectory, Array]:
        """Return the trajectory and the shortened polyline, or raise TimingError."""
        if np.abs(path[-1] - path[0]).max() < _SAME_RAD and len(path) == 2:
            return _rest(path[0], group), path
        with times.phase("shortcut"):
            path = shortcut(path, checker, np.random.default_rng(key), self.config.shortcut_rounds_n)
        with times.phase("blend"):
            curve = blended_path(path, checker, self.config.blend_radius_rad, checker.step_rad / 3.0)
        if curve is None:
            raise TimingError("a corner of the path stays blocked however small it is rounded")
        with times.phase("timing"):
            return time_path(curve, group, self.limits, self.kinematics), path


def _rest(q: Array, group: str) -> Trajectory:
    still = np.zeros((2, len(q)))
    return Trajectory(np.array([0.0, DT_S]), np.array([q, q]), still, still.copy(), group)


__all__ = ["PlanResult", "Planner", "PlanningError"]
