"""Plan query sets, held-object moves and the task's carries, and record the results."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from time import perf_counter, process_time

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.collision.scene import PlanningScene
from minidual.config.planning import PlanConfig
from minidual.config.root import Config
from minidual.config.seeds import stream, subseed
from minidual.control.kernels import apart
from minidual.motion.api import PLAN_PHASES, Planner, PlanResult
from minidual.motion.held.hands import HandsIK
from minidual.motion.held.path import CarriedTrajectory
from minidual.motion.held.planner import HeldPlanner, HeldQuery
from minidual.proof.scene_engines import Audit
from minidual.robot.kinematics import Kinematics, path_length
from minidual.robot.pair import inverse, robot_from
from minidual.skills.cycle import solve
from minidual.skills.phases import State
from minidual.skills.pipeline.search import TaskFailedError
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import pose_of
from minidual.trials.planning.held_moves import HeldMove, HeldMoveGenerator
from minidual.trials.planning.queries import Query, polyline_states, query_source

_LINE_STEP_RAD = 0.01


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
    begin = perf_counter()
    cpu_begin = process_time()
    result = None
    reason = ""
    message = ""
    try:
        result = plan()
    except PlanningError as error:
        reason = error.reason
        message = error.message
    return PlanAttempt(result, reason, message, perf_counter() - begin, process_time() - cpu_begin)


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
        audit = self.audit
        row: dict[str, object] = {name: getattr(query, name) for name in ("group", "index", "seed")}
        row |= {"ok": self.ok, "reason": self.reason, "kind": query.kind}
        row |= {"goal": "poses" if query.as_poses else "joints", "line_blocked": self.line_blocked}
        row |= {"total_s": self.total_s, "scene_setup_s": self.scene_s, "cpu_s": self.cpu_s}
        if result is not None:
            row |= {
                f"{phase}_s": result.times_s[phase] for phase in PLAN_PHASES if phase != "scene"
            }
            row |= {"direct": result.direct, "attempts_n": result.attempts_n}
            row |= {
                "path_length_rad": path_length(result.path),
                "duration_s": result.trajectory.duration_s,
            }
            row |= {name: getattr(result.verification, name) for name in _PROVEN}
        if audit is not None:
            row |= {"clearance_m": audit.clearance_m, "audited_n": audit.samples_n}
            row |= {"audit_collisions_n": audit.collisions_n}
        row["message"] = self.message
        return {
            name: round(value, 6) if isinstance(value, float) else value
            for name, value in row.items()
        }


_PROVEN = (
    "samples_n",
    "velocity_ratio",
    "acceleration_ratio",
    "jerk_ratio",
    "torque_ratio",
    "torque_rate_ratio",
)


def plan_query(planner: Planner, query: Query) -> QueryOutcome:
    """Plan one query, timed from goal to proven trajectory."""
    begin = perf_counter()
    engines = planner.engines(query.scene)
    scene_s = perf_counter() - begin
    where = (query.group, query.q_start)
    how = {"scene": query.scene, "seed": query.seed}
    if query.as_poses:
        attempt = attempted(lambda: planner.plan_to_poses(*where, query.targets, **how))
    else:
        attempt = attempted(lambda: planner.plan_to_joints(*where, query.q_goal, **how))
    q_goal = query.q_goal if attempt.result is None else attempt.result.q_goal
    line = polyline_states(np.array([query.q_start, q_goal]), _LINE_STEP_RAD)
    blocked = bool(engines.engine("mujoco").collisions(line).any())
    return QueryOutcome(**vars(attempt), query=query, scene_s=scene_s, line_blocked=blocked)


def _planner(config: Config) -> Planner:
    return Planner(config=config.plan.planner, robot=robot_from(config.robot))


def run_queries(
    config: Config,
    seed: int,
    queries_n: int,
    on_query: Callable[[QueryOutcome], None] = lambda _: None,
) -> dict[str, list[QueryOutcome]]:
    """Plan and audit queries of every group, in one process for comparable times."""
    plan = config.plan
    planner = _planner(config)
    warm = _planner(config)
    source = query_source(seed, plan.obstacles_n, plan.blocked_fraction, planner.robot)
    outcomes: dict[str, list[QueryOutcome]] = {group: [] for group in planner.robot.groups}
    # Warm up: the first plans load machine code, or compile it on a new machine (40 s); `make bench` times them.
    # They have a planner of their own: the first scene is then built for its query, and timed.
    for group in outcomes:
        plan_query(warm, source(group, 0))
    for group, done in outcomes.items():
        for index in range(queries_n):
            outcome = plan_query(planner, source(group, index))
            if outcome.result is not None:
                outcome = replace(
                    outcome,
                    audit=planner.engines(outcome.query.scene).audit(outcome.result.trajectory),
                )
            done.append(outcome)
            on_query(outcome)
    return outcomes


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
    half = states_n // 2
    uniform = rng.uniform(robot.q_lower, robot.q_upper, (half, robot.dof))
    near_home = robot.home + rng.uniform(-0.8, 0.8, (states_n - half, robot.dof))
    Q = np.vstack([uniform, np.clip(near_home, robot.q_lower, robot.q_upper)])
    return float(np.mean(engine("mujoco").collisions(Q) == engine("coal").collisions(Q)))


@dataclass(frozen=True, eq=False)
class MoveOutcome(PlanAttempt[CarriedTrajectory]):
    """Result of one move; residuals are those of `timed_residual`, clearance_m is the minimum. NaN without a plan."""

    move: HeldMove
    residual_m: float = np.nan
    residual_rad: float = np.nan
    clearance_m: float = np.nan

    def row(self, name: str) -> dict[str, object]:
        """Return the row of held_moves.csv."""
        move = self.move
        plan = self.result
        found = (
            {}
            if plan is None
            else {"found_by": plan.found_by, "duration_s": round(plan.duration_s, 4)}
        )
        if plan is not None:
            found |= {
                "residual_m": f"{self.residual_m:.3g}",
                "residual_rad": f"{self.residual_rad:.3g}",
            }
            found |= {"clearance_m": round(self.clearance_m, 6)}
        row: dict[str, object] = {
            "set": name,
            "index": move.index,
            "ok": self.ok,
            "reason": self.reason,
        }
        row |= {"with_obstacles": move.with_obstacles, "straight_blocked": move.blocked}
        way_m, turn_rad = apart(move.query.T_world_goal, move.T_world_start, np.empty(6))
        row |= {"distance_m": round(way_m, 4), "turn_rad": round(turn_rad, 4)}
        row |= {"time_s": round(self.total_s, 6), "cpu_s": round(self.cpu_s, 6), **found}
        row |= {"undecided_before_n": move.undecided_n, "unreachable_before_n": move.unreachable_n}
        return {**row, "message": self.message}


def timed_residual(
    plan: CarriedTrajectory,
    query: HeldQuery,
    kinematics: Kinematics,
) -> tuple[float, float]:
    """Return the largest error ([m], [rad]) of the hands along the trajectory.

    At the samples (1 kHz): each hand relative to its grasp and to the other; between samples: relative to the other.
    """
    hands = HandsIK(query.grasps, kinematics.robot)
    between, _, _ = plan.sample_many(plan.times[:-1] + 0.5 * plan.dt_s)
    T_tcp_object = inverse(query.grasps[0])
    # The object's pose follows from the left hand, so the error is that of the right hand against it.
    objects = np.array([kinematics.tcp_poses(q)[0] @ T_tcp_object for q in between])
    return tuple(
        np.max(
            [hands.strays(plan.q, plan.Ts_world_object), hands.strays(between, objects)],
            axis=0,
        ).tolist(),
    )


def plan_move(planner: HeldPlanner, move: HeldMove) -> MoveOutcome:
    """Plan and measure one move; building its scene is not timed."""
    engines = planner.planner.engines(move.query.scene)
    attempt = attempted(lambda: planner.plan(move.query))
    outcome = MoveOutcome(**vars(attempt), move=move)
    plan = attempt.result
    if plan is None:
        return outcome
    off_m, off_rad = timed_residual(plan, move.query, planner.planner.kinematics)
    return replace(
        outcome,
        residual_m=off_m,
        residual_rad=off_rad,
        clearance_m=engines.clearance(plan),
    )


def run_moves(
    config: Config,
    seed: int,
    on_move: Callable[[MoveOutcome], None] = lambda _: None,
) -> list[MoveOutcome]:
    """Plan `config.plan.held.moves_n` moves."""
    planner = HeldPlanner(_planner(config))
    generator = HeldMoveGenerator(seed, config.scene, planner.planner.robot)
    first = HeldMoveGenerator(
        subseed(seed, "held-move/warm-up"),
        config.scene,
        planner.planner.robot,
    )
    # Warm up imports and compilation, so that the first move is not charged for them.
    with suppress(PlanningError):
        planner.plan(first.move(0).query)
    outcomes = []
    for index in range(config.plan.held.moves_n):
        outcomes.append(plan_move(planner, generator.move(index)))
        on_move(outcomes[-1])
    return outcomes


def table_plans(config: Config, seed: int) -> tuple[list[CarriedTrajectory], list[str]]:
    """Return plans of the moves to be driven, from the table, and a line for each failure."""
    planner = HeldPlanner(_planner(config))
    generator = HeldMoveGenerator(seed, config.scene, planner.planner.robot, from_table=True)
    tried = [
        attempted(lambda k=k: planner.plan(generator.move(k).query))
        for k in range(config.plan.held.executed_n)
    ]
    failures = [
        f"held move {k} off the table cannot be driven: {t.message}"
        for k, t in enumerate(tried)
        if not t.ok
    ]
    return [t.result for t in tried if t.result is not None], failures


def failed_carries(config: Config, count: int) -> list[str]:
    """Plan `count` carries as method moveit does; return a line for each failure."""
    task = make_task(Config(scene=config.scene))
    seed = config.seed
    planner = _planner(config)
    body = task.objects[task.carried].body
    failures = []
    for k in range(count):
        trial = task.trial(seed, "plan", k)
        start = State(planner.robot.home, {body.name: pose_of(body, trial.start[body.name])})
        try:
            solve(task, trial, start, planner, subseed(seed, "planner/plan", k))
        except TaskFailedError as error:
            failures.append(f"carry {k}: {error.summary}")
    return failures
