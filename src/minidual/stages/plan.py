"""`minidual plan`: seeded queries for three groups, and moves of a held object.

All are planned, timed and proven.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

from minidual.collision.acm import acm_report
from minidual.config.planning import PlanConfig
from minidual.config.seeds import subseed
from minidual.durable import write_csv
from minidual.gate.check import Check
from minidual.gate.stage import StageContext, StageResult
from minidual.plant.world import World
from minidual.robot.pair import Robot, robot_from
from minidual.show.figures.planning import write_times
from minidual.show.planning import Outcomes, play_queries, write_paths
from minidual.show.view.overlay import Overlay
from minidual.show.watch import watched
from minidual.skills.held_execution import DrivenMove, execute
from minidual.stages import plan_criteria as criteria
from minidual.stages.plan_checks import (
    CARRIES_N,
    Moves,
    common_checks,
    group_checks,
    held_checks,
)
from minidual.trials.planning import evaluate, held_evaluate
from minidual.trials.planning.evaluate import QueryOutcome
from minidual.trials.planning.held_evaluate import MoveOutcome
from minidual.trials.planning.retiming import retime

_JSON_EVERY = 10
"""Samples of a trajectory between two in its JSON."""


def run(context: StageContext) -> StageResult:
    """Plan queries and carries, compare the engines, draw figures."""
    config = context.config.plan
    folder = context.folder
    first, second = _run_queries(context)
    play_queries(context.view, context.config.scene, first)
    scene = first["both_arms"][0].query.scene
    agreement = evaluate.engine_agreement(scene, config.agreement_states_n, context.seed)
    repeatable = all(evaluate.repeats(config, outcomes[0]) for outcomes in first.values())
    failed_carries = evaluate.failed_carries(context.config, CARRIES_N)
    retiming = retime(context.config, first)
    held = run_held(context)
    robot = robot_from(context.config.robot)
    _write_queries(context, first, second)
    _write_allowed_pairs(context, robot)
    _write_trajectories(context, first, robot)
    if context.pictures:
        write_paths(folder / "paths.png", context.config.scene, first)
        write_times(first, folder / "times.svg", config.time_median_max_s.model_dump())
    checks = [
        *_query_checks(first, config, ""),
        *_query_checks(second, config, "second_seed."),
        *common_checks(
            [*_flat(first), *_flat(second)],
            agreement,
            repeatable,
            len(failed_carries),
            config,
        ),
        criteria.OWN_TO_TOPPRA.report(retiming.median, paths_n=len(retiming.ratios)),
        *held_checks(held.outcomes, held.driven, config),
    ]
    executions = [dataclasses.asdict(drive) for drive in held.driven]
    return StageResult(
        checks=checks,
        data={"held_moves": {"executions": executions}},
        notes=[
            *failure_notes("first", first),
            *failure_notes("second", second),
            *failed_carries,
            *retiming.failures,
            *held.notes,
        ],
    )


def _run_queries(context: StageContext) -> tuple[Outcomes, Outcomes]:
    """Plan the queries of the run's seed and of the second seed."""
    config = context.config.plan
    count = 3 * (config.queries_n + config.second_queries_n)
    with context.progress.task("queries", count) as task:

        def advance(outcome: QueryOutcome) -> None:
            task.advance(note=outcome.query.group)

        first = evaluate.run_queries(context.config, context.seed, config.queries_n, advance)
        second = evaluate.run_queries(
            context.config,
            config.second_seed,
            config.second_queries_n,
            advance,
        )
    return first, second


def _flat(outcomes: Outcomes) -> list[QueryOutcome]:
    return [outcome for group_outcomes in outcomes.values() for outcome in group_outcomes]


def _query_checks(outcomes: Outcomes, config: PlanConfig, prefix: str) -> list[Check]:
    """Return the checks of every group; none of a set without queries."""
    if not _flat(outcomes):
        return []
    return [
        check
        for group, group_outcomes in outcomes.items()
        for check in group_checks(group, group_outcomes, config, prefix)
    ]


def _write_queries(context: StageContext, first: Outcomes, second: Outcomes) -> None:
    for name, outcomes in (("queries", first), ("queries_second_seed", second)):
        rows = [outcome.row() for outcome in _flat(outcomes)]
        if rows:
            write_csv(context.folder / f"{name}.csv", rows)


def _write_allowed_pairs(context: StageContext, robot: Robot) -> None:
    """Write the pairs of links that are not checked for collision, and why."""
    rows = [
        {"first": first, "second": second, "reason": reason}
        for first, second, reason in acm_report(robot).pairs
    ]
    write_csv(context.folder / "allowed_collisions.csv", rows)


def _write_trajectories(context: StageContext, outcomes: Outcomes, robot: Robot) -> None:
    """Write the first trajectory of each group."""
    names = robot.joint_names
    for group, group_outcomes in outcomes.items():
        plans = [o.result for o in group_outcomes if o.result is not None]
        if plans:
            trajectory = plans[0].trajectory
            path = context.folder / f"trajectory_{group}"
            trajectory.write_csv(path.with_suffix(".csv"), names)
            trajectory.write_json(path.with_suffix(".json"), names, _JSON_EVERY)


def failure_notes(set_name: str, outcomes: Outcomes) -> list[str]:
    """Return one line per failed query."""
    return [
        f"{group} query {o.query.index} of the {set_name} seed failed: {o.message}"
        for group, group_outcomes in outcomes.items()
        for o in group_outcomes
        if not o.ok
    ]


class HeldResults(NamedTuple):
    """Moves of a held object.

    Attributes:
        outcomes: Of both seeds.
        driven: Moves off the table that were driven.
        notes: A line per failed or undriven move.
    """

    outcomes: Moves
    driven: list[DrivenMove]
    notes: list[str]


def run_held(context: StageContext) -> HeldResults:
    """Plan moves of a held object for both seeds, drive some, and write held_moves.csv."""
    config = context.config
    held = config.plan.held
    seeds = {"first": context.seed, "second": subseed(context.seed, "held-move/second")}
    outcomes: dict[str, Sequence[MoveOutcome]] = {}
    driven: list[DrivenMove] = []
    count = 2 * held.moves_n + held.executed_n
    with context.progress.task("held moves", count) as task:
        for name, seed in seeds.items():

            def advance(_outcome: MoveOutcome, name: str = name) -> None:
                task.advance(note=name)

            outcomes[name] = held_evaluate.run_moves(config, seed, advance)
        world = World(config.scene, robot=robot_from(config.robot))
        plans, undriven_notes = held_evaluate.table_plans(config, context.seed)
        overlay = Overlay(title="plan, held-object move", mode="joint", source="plan")
        for plan in plans:
            with watched(context.view, world, lambda: overlay):
                driven.append(execute(plan, world))
            task.advance(note="driven")
    rows = [o.row(name) for name, set_outcomes in outcomes.items() for o in set_outcomes]
    write_csv(context.folder / "held_moves.csv", rows)
    failed_notes = [
        f"held move {o.move.index} of the {name} seed failed: {o.message}"
        for name, set_outcomes in outcomes.items()
        for o in set_outcomes
        if not o.ok
    ]
    return HeldResults(outcomes, driven, [*failed_notes, *undriven_notes])
