"""Plan moves of an object held in both hands, and record the results."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.config.root import Config
from minidual.config.seeds import subseed
from minidual.control.kernels import apart
from minidual.motion.held.hands import HandsIK
from minidual.motion.held.path import CarriedTrajectory
from minidual.motion.held.planner import HeldPlanner
from minidual.motion.held.query import HeldQuery
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import inverse
from minidual.trials.planning.evaluate import PlanAttempt, attempted, planner_of
from minidual.trials.planning.held_moves import HeldMove, HeldMoveGenerator


@dataclass(frozen=True, eq=False)
class MoveOutcome(PlanAttempt[CarriedTrajectory]):
    """Result of one move; NaN without a plan.

    Attributes:
        residual_m, residual_rad: Those of `timed_residual`.
        clearance_m: The least on the way.
    """

    move: HeldMove
    residual_m: float = np.nan
    residual_rad: float = np.nan
    clearance_m: float = np.nan

    def row(self, name: str) -> dict[str, object]:
        """Return the row of held_moves.csv."""
        move = self.move
        plan = self.result
        difference = np.empty(6)
        distance_m, turn_rad = apart(move.query.T_world_goal, move.T_world_start, difference)
        row: dict[str, object] = {
            "set": name,
            "index": move.index,
            "ok": self.ok,
            "reason": self.reason,
            "with_obstacles": move.with_obstacles,
            "straight_blocked": move.blocked,
            "distance_m": round(distance_m, 4),
            "turn_rad": round(turn_rad, 4),
            "time_s": round(self.total_s, 6),
            "cpu_s": round(self.cpu_s, 6),
        }
        if plan is not None:
            row["found_by"] = plan.found_by
            row["duration_s"] = round(plan.duration_s, 4)
            row["residual_m"] = f"{self.residual_m:.3g}"
            row["residual_rad"] = f"{self.residual_rad:.3g}"
            row["clearance_m"] = round(self.clearance_m, 6)
        row["undecided_before_n"] = move.undecided_n
        row["unreachable_before_n"] = move.unreachable_n
        row["message"] = self.message
        return row


def timed_residual(
    plan: CarriedTrajectory,
    query: HeldQuery,
    kinematics: Kinematics,
) -> tuple[float, float]:
    """Return the largest error ([m], [rad]) of the hands along the trajectory.

    At the samples (1 kHz): each hand relative to its grasp and to the other; between samples:
    relative to the other.
    """
    hands = HandsIK(query.grasps, kinematics.robot)
    between, _, _ = plan.sample_many(plan.times[:-1] + 0.5 * plan.dt_s)
    T_tcp_object = inverse(query.grasps[0])
    # The object's pose follows from the left hand, so the error is that of the right hand.
    objects = np.array([kinematics.tcp_poses(q)[0] @ T_tcp_object for q in between])
    at_samples = hands.strays(plan.q, plan.Ts_world_object)
    error_m, error_rad = np.max([at_samples, hands.strays(between, objects)], axis=0).tolist()
    return error_m, error_rad


def plan_move(planner: HeldPlanner, move: HeldMove) -> MoveOutcome:
    """Plan and measure one move; building its scene is not timed."""
    engines = planner.planner.engines(move.query.scene)
    attempt = attempted(lambda: planner.plan(move.query))
    plan = attempt.result
    outcome = MoveOutcome(
        result=plan,
        reason=attempt.reason,
        message=attempt.message,
        total_s=attempt.total_s,
        cpu_s=attempt.cpu_s,
        move=move,
    )
    if plan is None:
        return outcome
    residual_m, residual_rad = timed_residual(plan, move.query, planner.planner.kinematics)
    return replace(
        outcome,
        residual_m=residual_m,
        residual_rad=residual_rad,
        clearance_m=engines.clearance(plan),
    )


def run_moves(
    config: Config,
    seed: int,
    on_move: Callable[[MoveOutcome], None] = lambda _: None,
) -> list[MoveOutcome]:
    """Plan `config.plan.held.moves_n` moves."""
    planner = HeldPlanner(planner_of(config))
    robot = planner.planner.robot
    warm_up = HeldMoveGenerator(subseed(seed, "held-move/warm-up"), config.scene, robot)
    # Imports and compilation: the first move is not charged for them.
    with suppress(PlanningError):
        planner.plan(warm_up.move(0).query)
    generator = HeldMoveGenerator(seed, config.scene, robot)
    outcomes: list[MoveOutcome] = []
    for index in range(config.plan.held.moves_n):
        outcome = plan_move(planner, generator.move(index))
        outcomes.append(outcome)
        on_move(outcome)
    return outcomes


def table_plans(config: Config, seed: int) -> tuple[list[CarriedTrajectory], list[str]]:
    """Return plans of the moves to be driven, from the table, and a line for each failure."""
    planner = HeldPlanner(planner_of(config))
    generator = HeldMoveGenerator(seed, config.scene, planner.planner.robot, from_table=True)
    plans: list[CarriedTrajectory] = []
    failures: list[str] = []
    for index in range(config.plan.held.executed_n):
        attempt = attempted(lambda k=index: planner.plan(generator.move(k).query))
        if attempt.result is None:
            failures.append(
                f"held move {index} off the table cannot be driven: {attempt.message}",
            )
        else:
            plans.append(attempt.result)
    return plans, failures
