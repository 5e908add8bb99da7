"""Held-object moves of `minidual plan`: planned for two seeds, some driven."""

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from minidual.config.planning import PlanConfig
from minidual.config.seeds import subseed
from minidual.durable import write_csv
from minidual.gate.check import Check
from minidual.gate.stage import StageContext
from minidual.motion.held.hands import RESIDUAL_MAX_M, RESIDUAL_MAX_RAD
from minidual.plant.world import World
from minidual.robot.arms import robot_from
from minidual.show.view import Overlay
from minidual.show.watch import watched
from minidual.skills.held_execution import Execution, execute
from minidual.stages.words import Rows, worded
from minidual.trials.planning.evaluate_carries import MoveOutcome, run_moves, table_plans


@dataclass(frozen=True)
class HeldResults:
    """Outcomes of both sets, executions, and why others were not driven."""

    outcomes: Mapping[str, Sequence[MoveOutcome]]
    executions: Sequence[Execution]
    undriven: Sequence[str] = ()

    def notes(self) -> list[str]:
        """Return one line per failed or undriven move."""
        failed = [
            f"held move {o.move.index} of the {name} seed failed: {o.message}"
            for name, done in self.outcomes.items()
            for o in done
            if not o.ok
        ]
        return [*failed, *self.undriven]

    def data(self) -> dict[str, Any]:
        """Return numbers beyond the checks and held_moves.csv."""
        data: dict[str, Any] = {"executions": [dataclasses.asdict(e) for e in self.executions]}
        for name, done in self.outcomes.items():
            data[f"{name}_seed"] = {
                "moves_n": len(done),
                "solved_n": sum(o.ok for o in done),
                "found_by": dict(Counter(o.result.found_by for o in done if o.result is not None)),
                "with_obstacles_n": sum(o.move.with_obstacles for o in done),
                "straight_blocked_n": sum(o.move.blocked for o in done),
                "undecided_n": sum(o.move.undecided_n for o in done),
                "unreachable_n": sum(o.move.unreachable_n for o in done),
                "cpu_p99_s": float(np.percentile([o.cpu_s for o in done], 99)),
            }
        return data


def run_held(context: StageContext) -> HeldResults:
    """Plan the moves of both seeds, drive some, and write held_moves.csv."""
    config, seed, outcomes, executions = context.config, context.seed, {}, []
    held = config.plan.held
    with context.progress.task("held moves", 2 * held.moves_n + held.executed_n) as task:
        for name, own in {"first": seed, "second": subseed(seed, "held-move/second")}.items():
            outcomes[name] = run_moves(config, own, lambda _, name=name: task.advance(note=name))
        world = World(config.scene, robot=robot_from(config.robot))
        driven, undriven = table_plans(config, seed)
        words = Overlay(title="plan, held-object move", mode="joint", source="plan")
        for trajectory in driven:
            with watched(context.view, world, lambda: words):
                executions.append(execute(trajectory, config.scene, world=world))
            task.advance(note="driven")
    write_csv(context.folder / "held_moves.csv", [o.row(name) for name, done in outcomes.items() for o in done])
    return HeldResults(outcomes, executions, undriven)


def held_checks(results: HeldResults, config: PlanConfig) -> list[Check]:
    """Return the checks of the held-object moves."""
    held, first, second = config.held, results.outcomes["first"], results.outcomes["second"]
    every, driven = [*first, *second], results.executions
    nothing = [(np.nan, np.nan)]
    strays = np.max([(o.residual_m, o.residual_rad) for o in every if o.ok] or nothing, axis=0).tolist()
    errors = np.max([(e.error_max_m, e.error_max_rad) for e in driven] or nothing, axis=0).tolist()
    undecided, unreachable = (sum(getattr(o.move, n) for o in every) for n in ("undecided_n", "unreachable_n"))
    rates = [sum(o.ok for o in done) / len(done) for done in (first, second)]
    rows: Rows = {
        "success_rate": (rates[0], ">=", config.success_rate_min),
        "second_seed_success_rate": (rates[1], ">=", config.success_rate_min),
        "cpu_time_median_s": (float(np.median([o.cpu_s for o in first])), "<", held.cpu_time_median_max_s),
        "time_median_s": float(np.median([o.total_s for o in first])),
        "residual_max_m": (strays[0], "<", RESIDUAL_MAX_M),
        "residual_max_rad": (strays[1], "<", RESIDUAL_MAX_RAD),
        "draws_left_out_n": undecided,
        "driven_n": (len(driven), "==", held.executed_n),
        "executed_error_max_m": (errors[0], "<", held.executed_error_max_m),
        "executed_error_max_rad": (errors[1], "<", held.executed_error_max_rad),
    }
    named = {f"closed_chain.{name}": row for name, row in rows.items()}
    return worded("plan", named, undecided=undecided, unreachable=unreachable)
