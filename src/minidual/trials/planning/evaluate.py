"""Plan query sets and the task's carries, and record the results."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter, process_time

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.collision.scene import PlanningScene
from minidual.config.planning import PlanConfig
from minidual.config.root import Config
from minidual.config.seeds import stream, subseed
from minidual.motion.api import PLAN_PHASES, Planner, PlanResult
from minidual.proof.scene_engines import Audit
from minidual.robot.kinematics import path_length
from minidual.robot.pair import robot_from
from minidual.skills.cycle import solve
from minidual.skills.pipeline.search import TaskFailedError
from minidual.skills.states import State
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import pose_of
from minidual.trials.planning.queries import Query, polyline_states, query_source

_LINE_STEP_RAD = 0.01
_NEAR_HOME_RAD = 0.8
_PROVEN = (
    "samples_n",
    "velocity_ratio",
    "acceleration_ratio",
    "jerk_ratio",
    "torque_ratio",
    "torque_rate_ratio",
)


@dataclass(frozen=True, eq=False)
class PlanAttempt[R]:
    """One request: a proven result or why there is none, and its wall and processor time."""

    result: R | None
    reason: str
    message: str
    total_s: float
    cpu_s: float

    @property
    def ok(self) -> bool:
        """Whether a proven trajectory was found."""
        return self.result is not None


def attempted[R](plan: Callable[[], R]) -> PlanAttempt[R]:
    """Run a request; a `PlanningError` is the reason why there is no result."""
    begin_s = perf_counter()
    cpu_begin_s = process_time()
    result = None
    reason = ""
    message = ""
    try:
        result = plan()
    except PlanningError as error:
        reason = error.reason
        message = error.message
    total_s = perf_counter() - begin_s
    return PlanAttempt(result, reason, message, total_s, process_time() - cpu_begin_s)


@dataclass(frozen=True, eq=False)
class QueryOutcome(PlanAttempt[PlanResult]):
    """Result of one query.

    Attributes:
        scene_s: Time to build the scene; not in the other times.
        line_blocked: Whether the straight line to the planned goal posture collides.
    """

    query: Query
    scene_s: float
    line_blocked: bool
    audit: Audit | None = None

    def row(self) -> dict[str, object]:
        """Return the queries.csv row; values not found or audited are missing."""
        query = self.query
        result = self.result
        row: dict[str, object] = {
            "group": query.group,
            "index": query.index,
            "seed": query.seed,
            "ok": self.ok,
            "reason": self.reason,
            "kind": query.kind,
            "goal": "poses" if query.as_poses else "joints",
            "line_blocked": self.line_blocked,
            "total_s": self.total_s,
            "scene_setup_s": self.scene_s,
            "cpu_s": self.cpu_s,
        }
        if result is not None:
            for phase in PLAN_PHASES:
                if phase != "scene":
                    row[f"{phase}_s"] = result.times_s[phase]
            row["direct"] = result.direct
            row["attempts_n"] = result.attempts_n
            row["path_length_rad"] = path_length(result.path)
            row["duration_s"] = result.trajectory.duration_s
            for name in _PROVEN:
                row[name] = getattr(result.verification, name)
        if self.audit is not None:
            row["clearance_m"] = self.audit.clearance_m
            row["audited_n"] = self.audit.samples_n
            row["audit_collisions_n"] = self.audit.collisions_n
        row["message"] = self.message
        return {
            name: round(value, 6) if isinstance(value, float) else value
            for name, value in row.items()
        }


def plan_query(planner: Planner, query: Query, budget_s: float | None = None) -> QueryOutcome:
    """Plan one query, timed from goal to proven trajectory.

    `budget_s`: wall time, instead of the configuration's counted work.
    """
    begin_s = perf_counter()
    engines = planner.engines(query.scene)
    scene_s = perf_counter() - begin_s

    def plan() -> PlanResult:
        if query.as_poses:
            return planner.plan_to_poses(
                query.group,
                query.q_start,
                query.targets,
                scene=query.scene,
                seed=query.seed,
                budget_s=budget_s,
            )
        return planner.plan_to_joints(
            query.group,
            query.q_start,
            query.q_goal,
            scene=query.scene,
            seed=query.seed,
            budget_s=budget_s,
        )

    attempt = attempted(plan)
    q_goal = query.q_goal if attempt.result is None else attempt.result.q_goal
    line = polyline_states(np.array([query.q_start, q_goal]), _LINE_STEP_RAD)
    return QueryOutcome(
        result=attempt.result,
        reason=attempt.reason,
        message=attempt.message,
        total_s=attempt.total_s,
        cpu_s=attempt.cpu_s,
        query=query,
        scene_s=scene_s,
        line_blocked=bool(engines.engine("mujoco").collisions(line).any()),
    )


def planner_of(config: Config) -> Planner:
    """Return the configured planner."""
    return Planner(config=config.plan.planner, robot=robot_from(config.robot))


def run_queries(
    config: Config,
    seed: int,
    queries_n: int,
    on_query: Callable[[QueryOutcome], None] = lambda _: None,
) -> dict[str, list[QueryOutcome]]:
    """Plan and audit queries of every group, in one process for comparable times."""
    plan = config.plan
    planner = planner_of(config)
    source = query_source(seed, plan.obstacles_n, plan.blocked_fraction, planner.robot)
    groups = tuple(planner.robot.groups)
    # The first plans load machine code, or compile it on a new machine (40 s). They have a planner
    # of their own: the first scene is then built for its query, and timed.
    warm = planner_of(config)
    for group in groups:
        plan_query(warm, source(group, 0))
    outcomes: dict[str, list[QueryOutcome]] = {group: [] for group in groups}
    for group in groups:
        for index in range(queries_n):
            outcome = audited(plan_query(planner, source(group, index)), planner)
            outcomes[group].append(outcome)
            on_query(outcome)
    return outcomes


def audited(outcome: QueryOutcome, planner: Planner) -> QueryOutcome:
    """Return the outcome with the audit of its trajectory, if it has one."""
    if outcome.result is None:
        return outcome
    engines = planner.engines(outcome.query.scene)
    return replace(outcome, audit=engines.audit(outcome.result.trajectory))


def repeats(config: PlanConfig, outcome: QueryOutcome) -> bool:
    """Return whether a fresh planner reproduces a trajectory bit for bit."""
    if outcome.result is None:
        return False
    again = plan_query(Planner(outcome.query.scene, config.planner), outcome.query).result
    return again is not None and again.trajectory.digest() == outcome.result.trajectory.digest()


def engine_agreement(scene: PlanningScene, states_n: int, seed: int) -> float:
    """Return the fraction of random states on which both engines agree.

    Half are uniform (mostly in collision), half near home.
    """
    planner = Planner(scene)
    engine = planner.engines().engine
    robot = planner.robot
    rng = stream(seed, "plan/engine-agreement")
    half_n = states_n // 2
    uniform = rng.uniform(robot.q_lower, robot.q_upper, (half_n, robot.dof))
    offsets = rng.uniform(-_NEAR_HOME_RAD, _NEAR_HOME_RAD, (states_n - half_n, robot.dof))
    near_home = np.clip(robot.home + offsets, robot.q_lower, robot.q_upper)
    Q = np.vstack([uniform, near_home])
    return float(np.mean(engine("mujoco").collisions(Q) == engine("coal").collisions(Q)))


def failed_carries(config: Config, count: int) -> list[str]:
    """Plan `count` carries as method moveit does; return a line for each failure."""
    task = make_task(Config(scene=config.scene))
    seed = config.seed
    planner = planner_of(config)
    body = task.objects[task.carried].body
    failures: list[str] = []
    for k in range(count):
        trial = task.trial(seed, "plan", k)
        start = State(planner.robot.home, {body.name: pose_of(body, trial.start[body.name])})
        try:
            solve(task, trial, start, planner, subseed(seed, "planner/plan", k))
        except TaskFailedError as error:
            failures.append(f"carry {k}: {error.summary}")
    return failures
