"""Plan held-object moves and the task's carries."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.config.root import Config
from minidual.config.seeds import subseed
from minidual.motion.api import Planner
from minidual.motion.held.hands import HandsIK
from minidual.motion.held.path import CarriedTrajectory
from minidual.motion.held.planner import HeldPlanner, HeldQuery
from minidual.robot.arms import robot_from
from minidual.robot.kinematics import Kinematics
from minidual.robot.poses import inverse
from minidual.skills.cycle import pose_of, solve
from minidual.skills.pipeline.search import TaskFailedError
from minidual.skills.pipeline.state import State
from minidual.tasks.rod_carry import rod_carry
from minidual.trials.planning.evaluate import Attempt, attempted
from minidual.trials.planning.held_moves import HeldMove, HeldMoveGenerator


@dataclass(frozen=True, eq=False)
class MoveOutcome(Attempt[CarriedTrajectory]):
    """Result of one move; residuals are those of `timed_residual`, clearance_m is the minimum. NaN without a plan."""

    move: HeldMove
    residual_m: float = np.nan
    residual_rad: float = np.nan
    clearance_m: float = np.nan

    def row(self, name: str) -> dict[str, object]:
        """Return the row of held_moves.csv."""
        move, plan = self.move, self.result
        found = {} if plan is None else {"found_by": plan.found_by, "duration_s": round(plan.duration_s, 4)}
        if plan is not None:
            found |= {"residual_m": f"{self.residual_m:.3g}", "residual_rad": f"{self.residual_rad:.3g}"}
            found |= {"clearance_m": round(self.clearance_m, 6)}
        return {
            "set": name,
            "index": move.index,
            "ok": self.ok,
            "reason": self.reason,
            "with_obstacles": move.with_obstacles,
            "straight_blocked": move.blocked,
            "distance_m": round(move.distance_m, 4),
            "turn_rad": round(move.turn_rad, 4),
            "time_s": round(self.total_s, 6),
            "cpu_s": round(self.cpu_s, 6),
            **found,
            "undecided_before_n": move.undecided_n,
            "unreachable_before_n": move.unreachable_n,
            "message": self.message,
        }


def timed_residual(plan: CarriedTrajectory, query: HeldQuery, kinematics: Kinematics) -> tuple[float, float]:
    """Return the largest error ([m], [rad]) of the hands along the trajectory.

    At the samples (1 kHz): each hand relative to its grasp and to the other; between samples: relative to the other.
    """
    hands = HandsIK(query.grasps, kinematics)
    at_samples = hands.strays(plan.q, plan.Ts_world_object)
    between, _, _ = plan.sample_many(plan.times[:-1] + 0.5 * plan.dt_s)
    T_tcp_object = inverse(query.grasps[0])
    # The object's pose follows from the left hand, so the error is that of the right hand against it.
    objects = np.array([kinematics.tcp_poses(q)[0] @ T_tcp_object for q in between])
    halfway = hands.strays(between, objects)
    worst_m, worst_rad = np.max([at_samples, halfway], axis=0).tolist()
    return worst_m, worst_rad


def plan_move(planner: HeldPlanner, move: HeldMove) -> MoveOutcome:
    """Plan and measure one move; building its scene is not timed."""
    engines = planner.engines(move.query.scene)
    attempt = attempted(lambda: planner.plan(move.query))
    outcome, plan = MoveOutcome(**vars(attempt), move=move), attempt.result
    if plan is None:
        return outcome
    off_m, off_rad = timed_residual(plan, move.query, planner.kinematics)
    return replace(outcome, residual_m=off_m, residual_rad=off_rad, clearance_m=engines.clearance(plan))


def _planner(config: Config) -> Planner:
    return Planner(config=config.plan.planner, robot=robot_from(config.robot))


def run_moves(config: Config, seed: int, on_move: Callable[[MoveOutcome], None] = lambda _: None) -> list[MoveOutcome]:
    """Plan `config.plan.held.moves_n` moves."""
    planner = HeldPlanner(_planner(config))
    generator, first = (
        HeldMoveGenerator(s, config.scene, planner.planner.robot) for s in (seed, subseed(seed, "held-move/warm-up"))
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
    moves = range(config.plan.held.executed_n)
    tried = [attempted(lambda k=k: planner.plan(generator.move(k).query)) for k in moves]
    failures = [f"held move {k} off the table cannot be driven: {t.message}" for k, t in enumerate(tried) if not t.ok]
    return [t.result for t in tried if t.result is not None], failures


def failed_carries(config: Config, count: int) -> list[str]:
    """Plan `count` carries as method moveit does; return a line for each failure."""
    task, seed, planner = rod_carry(Config(scene=config.scene)), config.seed, _planner(config)
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
