"""Plan query sets and record the results."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter, process_time

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.collision.scene import PlanningScene
from minidual.config.planning import PlanConfig
from minidual.config.root import Config
from minidual.config.seeds import stream
from minidual.motion.api import Planner
from minidual.motion.result import PHASES, PlanResult
from minidual.motion.shortcut import path_length
from minidual.proof.scene_engines import Audit
from minidual.robot.arms import DUAL_PANDA, robot_from
from minidual.robot.pair import Robot
from minidual.trials.planning.queries import Query, QueryGenerator
from minidual.trials.planning.query_set import OBSTACLES_N, ROBOT, polyline_states, stored_query

_LINE_STEP_RAD = 0.01


@dataclass(frozen=True, eq=False)
class Attempt[R]:
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


def attempted[R](plan: Callable[[], R]) -> Attempt[R]:
    """Run a request; a `PlanningError` is the reason why there is no result."""
    begin, cpu_begin = perf_counter(), process_time()
    result, reason, message = None, "", ""
    try:
        result = plan()
    except PlanningError as error:
        reason, message = error.reason, error.message
    return Attempt(result, reason, message, perf_counter() - begin, process_time() - cpu_begin)


@dataclass(frozen=True, eq=False)
class Outcome(Attempt[PlanResult]):
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
        query, result, audit = self.query, self.result, self.audit
        row: dict[str, object] = {name: getattr(query, name) for name in ("group", "index", "seed")}
        row |= {
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
            row |= {f"{phase}_s": result.times_s[phase] for phase in PHASES if phase != "scene"}
            row |= {"direct": result.direct, "attempts_n": result.attempts_n}
            row |= {"path_length_rad": path_length(result.path), "duration_s": result.trajectory.duration_s}
            row |= {name: getattr(result.verification, name) for name in _PROVEN}
        if audit is not None:
            row |= {"clearance_m": audit.clearance_m, "audited_n": audit.samples_n}
            row |= {"audit_collisions_n": audit.collisions_n}
        row["message"] = self.message
        return {name: round(value, 6) if isinstance(value, float) else value for name, value in row.items()}


_PROVEN = ("samples_n", "velocity_ratio", "acceleration_ratio", "jerk_ratio", "torque_ratio")


def plan_query(planner: Planner, query: Query) -> Outcome:
    """Plan one query, timed from goal to proven trajectory."""
    begin = perf_counter()
    engines = planner.engines(query.scene)
    scene_s = perf_counter() - begin
    where, how = (query.group, query.q_start), {"scene": query.scene, "seed": query.seed}
    if query.as_poses:
        targets = query.targets
        attempt = attempted(lambda: planner.plan_to_poses(*where, targets, **how))
    else:
        attempt = attempted(lambda: planner.plan_to_joints(*where, query.q_goal, **how))
    q_goal = query.q_goal if attempt.result is None else attempt.result.q_goal
    line = polyline_states(np.array([query.q_start, q_goal]), _LINE_STEP_RAD)
    blocked = bool(engines.engine("mujoco").collisions(line).any())
    return Outcome(**vars(attempt), query=query, scene_s=scene_s, line_blocked=blocked)


def query_source(
    seed: int, obstacles_n: int, blocked_fraction: float, robot: Robot = DUAL_PANDA
) -> Callable[[str, int], Query]:
    """Return (group, index) -> query, from the stored set of the seed if there is one."""
    generator = QueryGenerator(seed, obstacles_n, blocked_fraction, robot)
    if (obstacles_n, blocked_fraction, robot) != (OBSTACLES_N, 1.0, ROBOT):
        return generator.query
    return lambda group, index: stored_query(seed, group, index) or generator.query(group, index)


def run_queries(
    config: Config, seed: int, queries_n: int, on_query: Callable[[Outcome], None] = lambda _: None
) -> dict[str, list[Outcome]]:
    """Plan and audit queries of every group, in one process for comparable times."""
    plan, robot = config.plan, robot_from(config.robot)
    planner, warm = (Planner(config=plan.planner, robot=robot) for _ in range(2))
    source = query_source(seed, plan.obstacles_n, plan.blocked_fraction, robot)
    outcomes: dict[str, list[Outcome]] = {group: [] for group in planner.robot.groups}
    # Warm up: the first plans load machine code, or compile it on a new machine (40 s); `make bench` times them.
    # They have a planner of their own: the first scene is then built for its query, and timed.
    for group in outcomes:
        plan_query(warm, source(group, 0))
    for group, done in outcomes.items():
        for index in range(queries_n):
            outcome = plan_query(planner, source(group, index))
            if outcome.result is not None:
                verifier = planner.engines(outcome.query.scene)
                outcome = replace(outcome, audit=verifier.audit(outcome.result.trajectory))
            done.append(outcome)
            on_query(outcome)
    return outcomes


def repeats(config: PlanConfig, outcome: Outcome) -> bool:
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
    engine, robot = planner.engines().engine, planner.robot
    lower, upper = robot.q_lower, robot.q_upper
    rng = stream(seed, "plan/engine-agreement")
    half = states_n // 2
    uniform = rng.uniform(lower, upper, (half, robot.dof))
    near_home = robot.home + rng.uniform(-0.8, 0.8, (states_n - half, robot.dof))
    Q = np.vstack([uniform, np.clip(near_home, lower, upper)])
    return float(np.mean(engine("mujoco").collisions(Q) == engine("coal").collisions(Q)))
