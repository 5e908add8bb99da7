"""From a goal to a proven trajectory."""

import functools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from time import perf_counter
from typing import NamedTuple, Self, Unpack

import numpy as np

from minidual.collision.errors import (
    GoalInCollisionError,
    NoPathInTimeError,
    PlanningError,
    TimingError,
)
from minidual.collision.scene import PlanningScene
from minidual.config.planning import PlannerConfig
from minidual.config.seeds import stream, subseed
from minidual.errors import UsageError
from minidual.motion.blend import SmoothPath, blended_path
from minidual.motion.budget import ATTEMPT_CHECKS_N, Budget, BudgetOptions
from minidual.motion.checks import check_joints, goal_joints, require_free
from minidual.motion.pose_goals import pose_goals
from minidual.motion.search import EdgeChecker, search
from minidual.motion.shortcut import shortcut
from minidual.motion.speed_profile import DT_S
from minidual.motion.timing import resting
from minidual.motion.timing_engines import TIMING_ENGINES
from minidual.proof.certificate import certify
from minidual.proof.scene_engines import SceneEngines, Verification
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, GROUP_ARMS, Array, Robot
from minidual.robot.trajectory import Trajectory

PLAN_PHASES: tuple[str, ...] = ("scene", "ik", "search", "shortcut", "blend", "timing", "verify")


class PlanResult(NamedTuple):
    """A proven plan.

    Attributes:
        path: Polyline (n, dof) after shortcutting.
        q_goal: Goal reached (dof,).
        times_s: Wall time of each of `PLAN_PHASES`, summed over attempts.
        notes: Why earlier attempts failed, or a straight move ends early.
        curve: The path with rounded corners, as it was timed; None for a plan that stays where it
            is, or a straight move.
    """

    trajectory: Trajectory
    path: Array
    q_goal: Array
    verification: Verification
    times_s: dict[str, float]
    total_s: float
    attempts_n: int
    notes: tuple[str, ...] = ()
    curve: SmoothPath | None = None

    @property
    def direct(self) -> bool:
        """Whether the path is one segment."""
        return len(self.path) == 2


_SCENES_KEPT = 8
_SAME_RAD = 1e-9
_TRIES_OF_FIRST = 4
_CHECKS_MAX = 10_000_000
_PADDING_MAX_M = 0.02
_STEP_MIN_RAD = 0.004
# More state checks per failed search: times are heavy-tailed, so several short searches beat a long
# one.
_PATIENCE = 1.5
_MORE_RESTARTS = 8


class Effort(NamedTuple):
    """Settings of the next attempt: padding, check step, state checks until it gives up."""

    padding_m: float
    step_rad: float
    checks_n: int
    fruitless_n: int = 0

    def after_no_path(self) -> Self:
        """Return less padding, for narrow passages, and more state checks."""
        checks_n = min(int(_PATIENCE * self.checks_n), max(self.checks_n, _CHECKS_MAX))
        return self._replace(
            padding_m=0.5 * self.padding_m,
            checks_n=checks_n,
            fruitless_n=self.fruitless_n + 1,
        )

    def after_no_proof(self) -> Self:
        """Return `more_padding` and finer steps."""
        return self._replace(
            padding_m=more_padding(self.padding_m),
            step_rad=max(0.5 * self.step_rad, _STEP_MIN_RAD),
        )

    def planner(self, first: str, fallbacks: Sequence[str]) -> str:
        """Return the first planner for four failed searches, then the fallbacks in turn."""
        turn = self.fruitless_n - _TRIES_OF_FIRST
        if turn < 0 or not fallbacks:
            return first
        return fallbacks[turn % len(fallbacks)]


def more_padding(padding_m: float) -> float:
    """Return 1.5 times the padding, up to 0.02 m; larger ones stay."""
    return max(padding_m, min(1.5 * padding_m, _PADDING_MAX_M))


class QueryOptions(BudgetOptions, total=False):
    """Keyword arguments of every query."""

    scene: PlanningScene | None
    """By default the planner's."""
    seed: int
    """By default 0."""


class Planner:
    """Plans for left_arm, right_arm and both_arms. One instance per process.

    `scene` is the default one. Equal queries with equal seeds give equal trajectories.

    Attributes:
        work: What all queries so far have spent.
    """

    _kernels_loaded = False

    def __init__(
        self,
        scene: PlanningScene | None = None,
        config: PlannerConfig | None = None,
        *,
        robot: Robot = DUAL_PANDA,
    ) -> None:
        self.config = config or PlannerConfig()
        self.scene = scene or PlanningScene(robot=robot)
        self.robot = self.scene.robot
        self.kinematics = Kinematics(self.robot)
        self.timing = TIMING_ENGINES[self.config.timing]
        self.work = Budget()
        self._engines = functools.lru_cache(_SCENES_KEPT)(self._built)

    def engines(self, scene: PlanningScene | None = None) -> SceneEngines:
        """Return a scene's engines; the last eight scenes are cached.

        Raises:
            UsageError: The scene has another robot.
        """
        scene = scene or self.scene
        if scene.robot != self.robot:
            raise UsageError(
                f"the planner is for the arms {self.robot.name}, the scene for {scene.robot.name}",
            )
        return self._engines(scene)

    def _built(self, scene: PlanningScene) -> SceneEngines:
        engines = SceneEngines(scene, self.config.verify_step_rad, self.kinematics)
        home = self.robot.home
        if not Planner._kernels_loaded:
            # Load the planes' machine code (0.3 s; 30 s if compiled) outside the times of queries.
            EdgeChecker(engines, 0.0, [home], 0.1).edge_free(home, home + 0.1)
            certify(engines.solids, resting(home, DT_S, "both_arms"))
            Planner._kernels_loaded = True
        return engines

    def load_kernels(self, scene: PlanningScene | None = None) -> None:
        """Load machine code if no planner of this process has."""
        if not Planner._kernels_loaded:
            self.engines(scene)

    def budget(self, **limits: Unpack[BudgetOptions]) -> Budget:
        """Return the budget of a query that begins now.

        Raises:
            UsageError: A limit is not finite and > 0.
        """
        checks_n = limits.get("budget_checks_n")
        wall_s = limits.get("budget_s")
        for name, limit in (("budget_checks_n", checks_n), ("budget_s", wall_s)):
            if limit is not None and not (np.isfinite(limit) and limit > 0):
                raise UsageError(f"{name} = {limit}; it must be a finite number > 0")
        if checks_n is None and wall_s is None:
            checks_n = self.config.budget_checks_n
        return Budget(
            np.inf if checks_n is None else checks_n,
            np.inf if wall_s is None else wall_s,
            within=self.work,
        )

    def plan_to_joints(
        self,
        group: str,
        q_start: Array,
        q_goal: Array,
        **options: Unpack[QueryOptions],
    ) -> PlanResult:
        """Plan to all joints or the group's [rad]; the other arm stands still.

        Raises:
            PlanningError: Bad start or goal, or nothing proven within the budget
                (NoPathInTimeError).
            UsageError: Bad group or budget, or a goal that moves the other arm.
        """
        work = _Work(self, group, q_start, **options)
        goal = goal_joints(group, work.q_start, q_goal, self.robot)
        require_free(work.engines, goal, "goal")
        return work.run([goal])

    def plan_to_poses(
        self,
        group: str,
        q_start: Array,
        targets: Mapping[str, Array],
        **options: Unpack[QueryOptions],
    ) -> PlanResult:
        """Plan to tcp poses {arm: T_world_tcp} of exactly the group's arms.

        Raises:
            IKUnreachableError: A pose is out of reach.
            And what `plan_to_joints` raises.
        """
        work = _Work(self, group, q_start, **options)
        return work.run(work.goals_at(targets))


class _Timed(NamedTuple):
    """A trajectory, its polyline (n, dof) and its curve."""

    trajectory: Trajectory
    path: Array
    curve: SmoothPath | None


class _Work:
    """One query in progress."""

    def __init__(
        self,
        planner: Planner,
        group: str,
        q_start: Array,
        **options: Unpack[QueryOptions],
    ) -> None:
        scene = options.get("scene")
        self.seed = options.get("seed", 0)
        planner.load_kernels(scene)  # before the clock starts: no query's time contains it
        self.arms = GROUP_ARMS[group]
        self.started = perf_counter()
        self.seconds = dict.fromkeys(PLAN_PHASES, 0.0)
        self.planner = planner
        self.config = planner.config
        self.group = group
        self.budget = planner.budget(
            budget_checks_n=options.get("budget_checks_n"),
            budget_s=options.get("budget_s"),
        )
        self.q_start = check_joints(q_start, "start", planner.robot)
        with self.phase("scene"):
            self.engines = planner.engines(scene)
        require_free(self.engines, self.q_start, "start")

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the block's wall time to a phase [s]."""
        begin = perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += perf_counter() - begin

    def goals_at(self, targets: Mapping[str, Array]) -> list[Array]:
        """Return goals (n,) at tcp poses {arm: T_world_tcp}."""
        restarts_n = self.config.ik_restarts_n
        rng = stream(self.seed, "motion/goals")
        with self.phase("ik"):
            try:
                return self._pose_goals(targets, rng, restarts_n)
            except GoalInCollisionError:
                # Two hands may be in each other's way at the few postures tried: try more.
                return self._pose_goals(targets, rng, _MORE_RESTARTS * restarts_n)

    def _pose_goals(
        self,
        targets: Mapping[str, Array],
        rng: np.random.Generator,
        restarts_n: int,
    ) -> list[Array]:
        return pose_goals(
            self.group,
            self.q_start,
            targets,
            self.engines,
            rng,
            restarts_n,
            self.config.goal_candidates_n,
        )

    def run(self, goals: Sequence[Array]) -> PlanResult:
        """Return the first proven plan to a goal (n,), or raise NoPathInTimeError."""
        config = self.config
        effort = Effort(config.padding_m, config.edge_step_rad, config.search_checks_n)
        notes: list[str] = []
        attempt = 0
        while not self.budget.ended:
            self.budget.spend(ATTEMPT_CHECKS_N)
            goal = goals[attempt % len(goals)]
            attempt += 1
            name = effort.planner(config.planner, config.fallback_planners)
            checker = self._checker(goal, effort)
            path = self._search(checker, goal, effort, name, attempt)
            if path is None:
                notes.append(f"{name} found no path in {checker.checks_n} state checks")
                effort = effort.after_no_path()
                continue
            try:
                timed = self._timed(path, checker, attempt)
                proof = self._proven(timed.trajectory)
            except PlanningError as error:
                notes.append(error.message)
                effort = effort.after_no_proof()
                continue
            return PlanResult(
                trajectory=timed.trajectory,
                path=timed.path,
                q_goal=goal,
                verification=proof,
                times_s=self.seconds,
                total_s=perf_counter() - self.started,
                attempts_n=attempt,
                notes=tuple(notes),
                curve=timed.curve,
            )
        last = notes[-1] if notes else "the budget ended before the first attempt"
        raise NoPathInTimeError(
            f"no proven path for {self.group} in {self.budget}: {attempt} attempts, the last one:"
            f" {last}",
            remedy="raise the budget, make room in the scene, or choose another goal",
        )

    def _checker(self, goal: Array, effort: Effort) -> EdgeChecker:
        # All pairs were checked at start and goal; only pairs with a moving part can change.
        with self.phase("search"):
            return EdgeChecker(
                self.engines,
                effort.padding_m,
                (self.q_start, goal),
                effort.step_rad,
                self.arms,
            )

    def _search(
        self,
        checker: EdgeChecker,
        goal: Array,
        effort: Effort,
        planner: str,
        attempt: int,
    ) -> Array | None:
        """Return a free polyline (n, dof), the straight one if possible, or None."""
        ends = np.array([self.q_start, goal])
        with self.phase("search"):
            if checker.edge_free(self.q_start, goal):
                return ends
            checker.allow(effort.checks_n, self.budget)
            return search(
                checker,
                ends,
                self.planner.robot.groups[self.group],
                seed=subseed(self.seed, "motion/search", attempt),
                planner=planner,
                range_rad=self.config.range_rad,
            )

    def _timed(self, path: Array, checker: EdgeChecker, attempt: int) -> _Timed:
        """Return the trajectory along the shortened path."""
        if np.abs(path[-1] - path[0]).max() < _SAME_RAD and len(path) == 2:
            return _Timed(resting(path[0], DT_S, self.group), path, None)
        config = self.config
        with self.phase("shortcut"):
            rng = stream(self.seed, "motion/shortcut", attempt)
            path = shortcut(path, checker, rng, config.shortcut_rounds_n)
        with self.phase("blend"):
            step_rad = checker.step_rad / 3.0
            curve = blended_path(path, checker, config.blend_radius_rad, step_rad)
        if curve is None:
            raise TimingError("a corner of the path stays blocked however small it is rounded")
        with self.phase("timing"):
            timed = self.planner.timing.time_path(
                curve,
                self.group,
                config,
                self.planner.kinematics,
            )
        return _Timed(timed.trajectory, path, curve)

    def _proven(self, trajectory: Trajectory) -> Verification:
        with self.phase("verify"):
            proof = self.engines.verify(trajectory, self.planner.timing.unlimited)
        if not proof.ok:
            raise PlanningError(f"proof failed: {proof.reason}")
        return proof
