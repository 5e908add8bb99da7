"""Plan a set of held-object moves and write down what happened to each; and the rod task's own carries."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import perf_counter, process_time

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.collision.scene import PlanningScene
from minidual.config.planning import PlanConfig
from minidual.config.scene import ObjectConfig, SceneConfig
from minidual.motion.api import Planner
from minidual.motion.held.hands import HandsIK
from minidual.motion.held.path import CarriedTrajectory
from minidual.motion.held.planner import HeldPlanner, HeldQuery, scene_holding
from minidual.robot.constants import HOME, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import inverse, pose, rot_z
from minidual.trials.planning.held_moves import HeldMove, HeldMoveGenerator, rod_grasps, rod_shape

CSV_COLUMNS = (
    "set",
    "index",
    "ok",
    "reason",
    "with_obstacles",
    "straight_blocked",
    "distance_m",
    "turn_rad",
    "time_s",
    "cpu_s",
    "found_by",
    "duration_s",
    "residual_m",
    "residual_rad",
    "clearance_m",
    "undecided_before_n",
    "unreachable_before_n",
    "message",
)


@dataclass(frozen=True, eq=False)
class MoveOutcome:
    """One move and what became of it; `plan` is None if it failed, and then `reason` and `message` say why.

    time_s is the wall time from the query going in to the proven trajectory coming out, with the scene's engines
    ready; cpu_s the processor time of the same. residual_m and residual_rad are measured again here, on the timed
    trajectory at every millisecond and half-way between: of each hand against its grasp on the object, and of the
    hands against each other; clearance_m is the smallest distance along it. NaN without a plan.
    """

    move: HeldMove
    plan: CarriedTrajectory | None
    reason: str
    message: str
    time_s: float
    cpu_s: float
    residual_m: float
    residual_rad: float
    clearance_m: float

    @property
    def ok(self) -> bool:
        """Whether a proven trajectory was found."""
        return self.plan is not None

    def row(self, name: str) -> dict[str, object]:
        """Return the line of held_moves.csv for a set of this name."""
        move, plan = self.move, self.plan
        values = (
            name,
            move.index,
            self.ok,
            self.reason,
            move.with_obstacles,
            move.blocked,
            round(move.distance_m, 4),
            round(move.turn_rad, 4),
            round(self.time_s, 6),
            round(self.cpu_s, 6),
            "" if plan is None else plan.found_by,
            "" if plan is None else round(plan.duration_s, 4),
            "" if plan is None else f"{self.residual_m:.3g}",
            "" if plan is None else f"{self.residual_rad:.3g}",
            "" if plan is None else round(self.clearance_m, 6),
            move.undecided_n,
            move.unreachable_n,
            self.message,
        )
        return dict(zip(CSV_COLUMNS, values, strict=True))


def timed_residual(plan: CarriedTrajectory, query: HeldQuery, kinematics: Kinematics) -> tuple[float, float]:
    """Return the largest error ([m], [rad]) of the hands along the timed trajectory.

    At the samples (1 kHz), where the object's planned pose is known, each hand against its grasp and the hands against
    each other; half-way between samples, the hands against each other.
    """
    hands = HandsIK(query.T_object_tcp_left, query.T_object_tcp_right, kinematics)
    at_samples = hands.strays(plan.q, plan.Ts_world_object)
    between, _, _ = plan.sample_many(plan.times[:-1] + 0.5 * plan.dt_s)
    T_tcp_object = inverse(query.T_object_tcp_left)
    # The left hand tells where the object is: what remains is the right hand against the left one.
    objects = np.array([kinematics.tcp_poses(q)[0] @ T_tcp_object for q in between])
    halfway = hands.strays(between, objects)
    worst_m, worst_rad = np.max([at_samples, halfway], axis=0).tolist()
    return worst_m, worst_rad


def plan_move(planner: HeldPlanner, move: HeldMove, kinematics: Kinematics) -> MoveOutcome:
    """Plan one move and measure it."""
    verifier = planner.engines(move.query.scene).verifier
    begin, cpu = perf_counter(), process_time()
    nan = float("nan")
    try:
        plan = planner.plan(move.query)
    except PlanningError as error:
        taken = perf_counter() - begin, process_time() - cpu
        return MoveOutcome(move, None, error.reason, error.message, *taken, nan, nan, nan)
    taken = perf_counter() - begin, process_time() - cpu
    residual = timed_residual(plan, move.query, kinematics)
    return MoveOutcome(move, plan, "", "", *taken, *residual, verifier.clearance(plan))


def run_moves(
    config: PlanConfig, rod: ObjectConfig, seed: int, on_move: Callable[[MoveOutcome], None] | None = None
) -> list[MoveOutcome]:
    """Plan `config.held.moves_n` moves of one generator seed.

    Args:
        config: Number of moves, padding, budget.
        rod: The object.
        seed: Seed of the set.
        on_move: Called after each.
    """
    planner, kinematics, generator = (
        HeldPlanner(Planner(config=config.planner)),
        Kinematics(),
        HeldMoveGenerator(seed, rod),
    )
    # Import and compile what the first move would otherwise pay for; whether this one is solved does not matter.
    with suppress(PlanningError):
        planner.plan(HeldMoveGenerator(seed + 1, rod).move(0).query)
    outcomes = []
    for index in range(config.held.moves_n):
        outcomes.append(plan_move(planner, generator.move(index), kinematics))
        if on_move is not None:
            on_move(outcomes[-1])
    return outcomes


@dataclass(frozen=True, eq=False)
class TablePlans:
    """Plans for driving, and one line for each that could not be made."""

    plans: tuple[CarriedTrajectory, ...]
    failures: tuple[str, ...]


def table_plans(config: PlanConfig, rod: ObjectConfig, count: int, seed: int) -> TablePlans:
    """Return `count` plans that lift the rod off the table and move it, for driving them in the simulator."""
    planner, generator = HeldPlanner(Planner(config=config.planner)), HeldMoveGenerator(seed, rod, from_table=True)
    plans: list[CarriedTrajectory] = []
    failures: list[str] = []
    for index in range(count):
        try:
            plans.append(planner.plan(generator.move(index).query))
        except PlanningError as error:
            failures.append(f"held move {index} off the table cannot be driven: {error.message}")
    return TablePlans(tuple(plans), tuple(failures))


@dataclass(frozen=True)
class CarryPlans:
    """Carries of the rod by both hands, planned as a closed chain; None where none was solved."""

    planned_n: int
    solved_n: int
    residual_max_m: float | None
    residual_max_rad: float | None
    time_median_s: float | None
    failures: tuple[str, ...]


def plan_carries(config: PlanConfig, scene: SceneConfig, count: int, seed: int) -> CarryPlans:
    """Plan the rod's carry from `count` random starts to the goal, with the rod in the collision scene.

    Args:
        config: Planner of the approach.
        scene: Rod and task.
        count: Number of carries.
        seed: Seed of the starts.
    """
    rod, task = scene.rod, scene.task
    grasps = rod_grasps(rod)
    holding = scene_holding(PlanningScene(), rod_shape(rod), grasps[0])
    approach = Planner(config=config.planner)
    carried = HeldPlanner(approach)
    rng = np.random.default_rng([seed, 13])
    times, failures = [], []
    residuals: list[tuple[float, float]] = []
    for k in range(count):
        dx, dy = rng.uniform(-task.start_range_m, task.start_range_m, 2)
        yaw = rng.uniform(-task.start_range_rad, task.start_range_rad)
        start = pose(rot_z(yaw), (task.start_xy_m[0] + dx, task.start_xy_m[1] + dy, rod.radius_m))
        goal = pose(np.eye(3), (*task.goal_xy_m, rod.radius_m))
        try:
            reached = approach.plan_to_poses(
                "both_arms", HOME, {"left": start @ grasps[0], "right": start @ grasps[1]}, seed=k
            )
            begin = perf_counter()
            waypoints = [start, _raised(start, task.lift_height_m), _raised(goal, task.lift_height_m), goal]
            plan = carried.follow(reached.q_goal, waypoints, *grasps, scene=holding)
        except PlanningError as error:
            failures.append(f"carry {k}: {error.message}")
            continue
        times.append(perf_counter() - begin)
        residuals.append((plan.residual_m, plan.residual_rad))
    if not residuals:
        return CarryPlans(count, 0, None, None, None, tuple(failures))
    worst_m, worst_rad = np.max(residuals, axis=0)
    return CarryPlans(count, len(times), float(worst_m), float(worst_rad), float(np.median(times)), tuple(failures))


def _raised(T: Array, height_m: float) -> Array:
    T = T.copy()
    T[2, 3] += height_m
    return T


def excluded(outcomes: Sequence[MoveOutcome]) -> tuple[int, int]:
    """Return how many draws were left out while the set was made: (without a witness, unreachable)."""
    return sum(o.move.undecided_n for o in outcomes), sum(o.move.unreachable_n for o in outcomes)
