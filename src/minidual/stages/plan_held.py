"""The closed-chain part of `minidual plan`: moves of a held object, planned by two seeds, and some of them driven."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from minidual.gate.check import Check
from minidual.gate.stage import StageContext

if TYPE_CHECKING:
    from minidual.config.held_moves import HeldMovesConfig
    from minidual.config.planning import PlanConfig
    from minidual.skills.held_execution import Execution
    from minidual.trials.planning.evaluate_carries import MoveOutcome

_SETS = ("first", "second")
_SECOND_SEED_OFFSET = 7919
_DRIVEN_SEED_OFFSET = 104_729


class HeldResults:
    """What the moves gave: outcomes of the two sets by name, the executions, and why others could not be driven."""

    def __init__(
        self,
        outcomes: Mapping[str, Sequence[MoveOutcome]],
        executions: Sequence[Execution],
        undriven: Sequence[str] = (),
    ) -> None:
        self.outcomes = outcomes
        self.executions = executions
        self.undriven = undriven


def run_held(context: StageContext) -> HeldResults:
    """Plan the moves of both seeds and drive some; writes held_moves.csv."""
    from minidual.plant.world import World
    from minidual.show.view import Overlay
    from minidual.show.watch import watched
    from minidual.skills.held_execution import execute
    from minidual.trials.planning.evaluate_carries import run_moves, table_plans

    plan, scene = context.config.plan, context.config.scene
    held = plan.held
    outcomes = {}
    with context.progress.task("held moves", 2 * held.moves_n + held.executed_n) as task:
        for name, offset in zip(_SETS, (0, _SECOND_SEED_OFFSET), strict=True):
            outcomes[name] = run_moves(
                plan, scene.rod, context.seed + offset, on_move=lambda _o, name=name: task.advance(note=f"{name} seed")
            )
        world = World(scene)
        executions = []
        driven = table_plans(plan, scene.rod, held.executed_n, context.seed + _DRIVEN_SEED_OFFSET)
        for trajectory in driven.plans:
            with watched(
                context.view, world, lambda: Overlay(title="plan, held-object move", mode="joint", source="plan")
            ):
                executions.append(execute(trajectory, scene, world=world))
            task.advance(note="driven")
    _write_csv(outcomes, context.folder / "held_moves.csv")
    return HeldResults(outcomes, executions, driven.failures)


def held_checks(results: HeldResults, config: PlanConfig) -> list[Check]:
    """Return the checks of the held-object moves."""
    checks = _planning_checks(results.outcomes, config)
    return checks + _execution_checks(results.executions, config.held)


def _planning_checks(outcomes: Mapping[str, Sequence[MoveOutcome]], config: PlanConfig) -> list[Check]:
    import numpy as np

    from minidual.motion.held.path import RESIDUAL_MAX_M, RESIDUAL_MAX_RAD
    from minidual.trials.planning.evaluate_carries import excluded

    every = [o for done in outcomes.values() for o in done]
    solved = [o for o in every if o.ok]
    left_out = {name: excluded(done)[0] for name, done in outcomes.items()}
    residuals = np.array([[o.residual_m, o.residual_rad] for o in solved] or [[np.nan, np.nan]])
    first = outcomes[_SETS[0]]
    limit = config.held.cpu_time_median_max_s
    cpu_median = float(np.median([o.cpu_s for o in first]))
    limited = () if limit is None else ("<", limit)
    return [
        Check(
            "closed_chain.success_rate",
            _rate(first),
            ">=",
            config.success_rate_min,
            why="moves of a held object up to 0.5 m and 90 degrees, each with a free path as witness, proven free",
            remedy="see the reasons in held_moves.csv",
        ),
        Check(
            "closed_chain.second_seed_success_rate",
            _rate(outcomes[_SETS[1]]),
            ">=",
            config.success_rate_min,
            why="a set of another seed must do as well",
            remedy="see the reasons in held_moves.csv",
        ),
        Check(
            "closed_chain.cpu_time_median_s",
            cpu_median,
            *limited,
            unit="s",
            why="processor time from the query going in to the proven trajectory coming out: the wall time of a quiet "
            "machine, since one thread does the work",
            remedy="see cpu_s in held_moves.csv",
        ),
        Check(
            "closed_chain.time_median_s",
            float(np.median([o.time_s for o in first])),
            unit="s",
            why="wall time of the same; more than the processor time where the machine is busy",
        ),
        Check(
            "closed_chain.residual_max_m",
            float(np.max(residuals[:, 0])),
            "<",
            RESIDUAL_MAX_M,
            unit="m",
            why="how far a hand strays from its grasp, or from the other hand, at 1 kHz and half-way between",
        ),
        Check(
            "closed_chain.residual_max_rad",
            float(np.max(residuals[:, 1])),
            "<",
            RESIDUAL_MAX_RAD,
            unit="rad",
            why="how far a hand turns away from its grasp (limit 0.05 degrees)",
        ),
        Check(
            "closed_chain.undecided_n",
            sum(left_out.values()),
            why="moves left out of the two sets because a long search found no free path for them",
        ),
    ]


def _execution_checks(executions: Sequence[Execution], config: HeldMovesConfig) -> list[Check]:
    import numpy as np

    errors = np.array([[e.error_max_m, e.error_max_rad] for e in executions] or [[np.nan, np.nan]])
    return [
        Check(
            "closed_chain.driven_n",
            len(executions),
            "==",
            config.executed_n,
            why="every move off the table that is to be driven is planned, proven and driven",
            remedy="see the notes of this stage",
        ),
        Check(
            "closed_chain.executed_error_max_m",
            float(np.max(errors[:, 0])),
            "<",
            config.executed_error_max_m,
            unit="m",
            why="the rod against the plan at every millisecond of the simulated drive, from closed hands to rest",
        ),
        Check(
            "closed_chain.executed_error_max_rad",
            float(np.max(errors[:, 1])),
            "<",
            config.executed_error_max_rad,
            unit="rad",
            why="the same for the rod's orientation",
        ),
    ]


def _rate(outcomes: Sequence[MoveOutcome]) -> float:
    return sum(o.ok for o in outcomes) / len(outcomes)


def held_data(results: HeldResults) -> dict[str, Any]:
    """Return what the stage keeps of the moves beside its checks."""
    import dataclasses
    from collections import Counter

    import numpy as np

    from minidual.trials.planning.evaluate_carries import excluded

    data: dict[str, Any] = {"executions": [dataclasses.asdict(e) for e in results.executions]}
    for name, done in results.outcomes.items():
        times, cpu = (np.array([getattr(o, field) for o in done]) for field in ("time_s", "cpu_s"))
        undecided, unreachable = excluded(done)
        data[f"{name}_seed"] = {
            "moves_n": len(done),
            "solved_n": sum(o.ok for o in done),
            "found_by": dict(Counter(o.plan.found_by for o in done if o.plan is not None)),
            "with_obstacles_n": sum(o.move.with_obstacles for o in done),
            "straight_blocked_n": sum(o.move.blocked for o in done),
            "undecided_n": undecided,
            "unreachable_n": unreachable,
            "time_median_s": float(np.median(times)),
            "time_p99_s": float(np.percentile(times, 99)),
            "cpu_median_s": float(np.median(cpu)),
            "cpu_p99_s": float(np.percentile(cpu, 99)),
        }
    return data


def held_notes(results: HeldResults) -> list[str]:
    """Return one line for every move that failed."""
    failed = [
        f"held move {o.move.index} of the {name} seed failed: {o.message}"
        for name, done in results.outcomes.items()
        for o in done
        if not o.ok
    ]
    return [*failed, *results.undriven]


def _write_csv(outcomes: Mapping[str, Sequence[MoveOutcome]], path: Path) -> None:
    import csv

    from minidual.trials.planning.evaluate_carries import CSV_COLUMNS

    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=CSV_COLUMNS)
        writer.writeheader()
        writer.writerows(o.row(name) for name, done in outcomes.items() for o in done)
