"""`minidual plan`: seeded queries for three groups, planned, timed and proven, and moves of a held object."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from minidual.collision.acm import acm_report
from minidual.config.planning import PlanConfig
from minidual.config.seeds import subseed
from minidual.durable import write_csv
from minidual.gate.check import Check, Rows
from minidual.gate.stage import StageContext, StageResult
from minidual.motion.held.hands import RESIDUAL_MAX_M, RESIDUAL_MAX_RAD
from minidual.plant.world import World
from minidual.robot.pair import robot_from
from minidual.show.figures.planning import write_times
from minidual.show.planning import Outcomes, play_queries, write_paths
from minidual.show.view.overlay import Overlay
from minidual.show.watch import watched
from minidual.skills.held_execution import DrivenMove, execute
from minidual.stages.words import worded
from minidual.trials.planning import evaluate, held_evaluate
from minidual.trials.planning.evaluate import QueryOutcome
from minidual.trials.planning.held_evaluate import MoveOutcome

_CARRIES_N = 5
_JSON_EVERY = 10

Moves = Mapping[str, Sequence[MoveOutcome]]


def run(context: StageContext) -> StageResult:
    """Plan queries and carries, compare the engines, draw figures."""
    config = context.config.plan
    folder = context.folder
    seed = context.seed
    robot = robot_from(context.config.robot)
    with context.progress.task("queries", 3 * (config.queries_n + config.second_queries_n)) as task:

        def advance(outcome: QueryOutcome) -> None:
            task.advance(note=outcome.query.group)

        outcomes = evaluate.run_queries(context.config, seed, config.queries_n, advance)
        second = evaluate.run_queries(
            context.config,
            config.second_seed,
            config.second_queries_n,
            advance,
        )
    play_queries(context.view, context.config.scene, outcomes)
    agreement = evaluate.engine_agreement(
        outcomes["both_arms"][0].query.scene,
        config.agreement_states_n,
        seed,
    )
    repeatable = all(evaluate.repeats(config, done[0]) for done in outcomes.values())
    carries = evaluate.failed_carries(context.config, _CARRIES_N)
    moves, executions, undriven = run_held(context)
    checks = list[Check]()
    every = list[QueryOutcome]()
    for prefix, ending, of in (("", "", outcomes), ("second_seed.", "_second_seed", second)):
        if asked := [o for done in of.values() for o in done]:
            write_csv(folder / f"queries{ending}.csv", [o.row() for o in asked])
            checks += [
                check
                for group, done in of.items()
                for check in group_checks(group, done, config, prefix)
            ]
        every += asked
    pairs = [
        {"first": a, "second": b, "reason": reason} for a, b, reason in acm_report(robot).pairs
    ]
    write_csv(folder / "allowed_collisions.csv", pairs)
    for group, done in outcomes.items():
        if (
            trajectory := next((o.result.trajectory for o in done if o.result is not None), None)
        ) is not None:
            trajectory.write_csv(folder / f"trajectory_{group}.csv", robot.joint_names)
            trajectory.write_json(
                folder / f"trajectory_{group}.json",
                robot.joint_names,
                _JSON_EVERY,
            )
    write_paths(folder / "paths.png", context.config.scene, outcomes)
    write_times(outcomes, folder / "times.png", config.time_median_max_s.model_dump())
    checks += common_checks(every, agreement, repeatable, len(carries), config)
    checks += held_checks(moves, executions, config)
    data = {"held_moves": {"executions": [dataclasses.asdict(e) for e in executions]}}
    return StageResult(
        checks=checks,
        data=data,
        notes=[*notes(first=outcomes, second=second), *carries, *undriven],
    )


def group_checks(
    group: str,
    outcomes: Sequence[QueryOutcome],
    config: PlanConfig,
    prefix: str = "",
) -> list[Check]:
    """Return the checks of one planning group."""
    times = np.array([o.total_s for o in outcomes])
    median_max_s = getattr(config.time_median_max_s, group)
    blocked_n = sum(o.line_blocked for o in outcomes)
    core_share = sum(o.cpu_s for o in outcomes) / max(1e-9, sum(o.total_s for o in outcomes))
    rows: Rows = {
        "success_rate": (float(np.mean([o.ok for o in outcomes])), ">=", config.success_rate_min),
        "first_plan_median_s": float(np.median([o.scene_s + o.total_s for o in outcomes])),
        "replan_median_s": (float(np.median(times)), "<", median_max_s),
        "replan_p99_s": float(np.percentile(times, 99)),
        "replan_max_s": (float(times.max()), "<", config.time_max_s),
        "core_share": core_share,
        "line_blocked_rate": blocked_n / len(outcomes),
    }
    return worded(
        "plan",
        rows,
        f"{prefix}{group}.",
        core_share=core_share,
        blocked_n=blocked_n,
        queries_n=len(outcomes),
    )


def common_checks(
    outcomes: Sequence[QueryOutcome],
    agreement: float,
    repeatable: bool,
    carries_failed_n: int,
    config: PlanConfig,
) -> list[Check]:
    """Return the checks common to all groups. Of the audit: dense samples of solved queries must be free."""
    audits = [o.audit for o in outcomes if o.audit is not None]
    rows: Rows = {
        "proof.audited_n": (len(audits), "==", sum(o.ok for o in outcomes)),
        "proof.audit_states": (sum(a.samples_n for a in audits), ">", 0),
        "proof.audit_collisions": (sum(a.collisions_n for a in audits), "==", 0),
        "proof.audit_disagreements": (sum(a.disagreements_n for a in audits), "==", 0),
        "engines.agreement": (agreement, ">=", config.agreement_min),
        "repeatable": (repeatable, "==", True),
        "closed_chain.carries_rate": (
            1.0 - carries_failed_n / _CARRIES_N,
            ">=",
            config.success_rate_min,
        ),
    }
    return worded("plan", rows)


def notes(**sets: Outcomes) -> list[str]:
    """Return one line per failed query."""
    lines = []
    for name, outcomes in sets.items():
        for group, done in outcomes.items():
            lines += [
                f"{group} query {o.query.index} of the {name} seed failed: {o.message}"
                for o in done
                if not o.ok
            ]
    return lines


def run_held(context: StageContext) -> tuple[Moves, list[DrivenMove], list[str]]:
    """Plan moves of a held object for both seeds, drive some, and write held_moves.csv.

    Return the outcomes of both sets, the drives, and a line per failed or undriven move.
    """
    config = context.config
    seed = context.seed
    outcomes = {}
    executions = list[DrivenMove]()
    held = config.plan.held
    with context.progress.task("held moves", 2 * held.moves_n + held.executed_n) as task:
        for name, own in {"first": seed, "second": subseed(seed, "held-move/second")}.items():
            outcomes[name] = held_evaluate.run_moves(
                config,
                own,
                lambda _, name=name: task.advance(note=name),
            )
        world = World(config.scene, robot=robot_from(config.robot))
        driven, undriven = held_evaluate.table_plans(config, seed)
        words = Overlay(title="plan, held-object move", mode="joint", source="plan")
        for trajectory in driven:
            with watched(context.view, world, lambda: words):
                executions.append(execute(trajectory, world))
            task.advance(note="driven")
    write_csv(
        context.folder / "held_moves.csv",
        [o.row(name) for name, done in outcomes.items() for o in done],
    )
    failed = [(name, o) for name, done in outcomes.items() for o in done if not o.ok]
    lines = [
        f"held move {o.move.index} of the {name} seed failed: {o.message}" for name, o in failed
    ]
    return outcomes, executions, [*lines, *undriven]


def held_checks(outcomes: Moves, driven: Sequence[DrivenMove], config: PlanConfig) -> list[Check]:
    """Return the checks of the held-object moves."""
    held = config.held
    first = outcomes["first"]
    second = outcomes["second"]
    every = [*first, *second]
    nothing = [(np.nan, np.nan)]
    strays = np.max(
        [(o.residual_m, o.residual_rad) for o in every if o.ok] or nothing,
        axis=0,
    ).tolist()
    errors = np.max([(e.error_max_m, e.error_max_rad) for e in driven] or nothing, axis=0).tolist()
    undecided, unreachable = (
        sum(getattr(o.move, n) for o in every) for n in ("undecided_n", "unreachable_n")
    )
    rates = [sum(o.ok for o in done) / len(done) for done in (first, second)]
    rows: Rows = {
        "success_rate": (rates[0], ">=", config.success_rate_min),
        "second_seed_success_rate": (rates[1], ">=", config.success_rate_min),
        "cpu_time_median_s": (
            float(np.median([o.cpu_s for o in first])),
            "<",
            held.cpu_time_median_max_s,
        ),
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
