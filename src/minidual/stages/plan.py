"""`minidual plan`: seeded queries for three groups, planned, timed and proven."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from minidual.collision.acm import acm_report
from minidual.config.planning import PlanConfig
from minidual.durable import write_csv
from minidual.gate.check import Check
from minidual.gate.stage import StageContext, StageResult
from minidual.robot.arms import robot_from
from minidual.show.figures.planning import write_times
from minidual.show.planning import play_queries, write_paths
from minidual.stages.plan_held import held_checks, run_held
from minidual.stages.words import Rows, worded
from minidual.trials.planning.evaluate import Outcome, engine_agreement, repeats, run_queries
from minidual.trials.planning.evaluate_carries import failed_carries

_EXCELLENT_S = {"left_arm": 0.2, "right_arm": 0.2, "both_arms": 2.0}
_GOAL_S = {"left_arm": 0.01, "right_arm": 0.01, "both_arms": 0.015}
_CARRIES_N = 5
_JSON_EVERY = 10

Outcomes = Mapping[str, Sequence[Outcome]]


def run(context: StageContext) -> StageResult:
    """Plan queries and carries, compare the engines, draw figures."""
    config, folder, seed = context.config.plan, context.folder, context.seed
    robot = robot_from(context.config.robot)
    with context.progress.task("queries", 3 * (config.queries_n + config.second_queries_n)) as task:

        def advance(outcome: Outcome) -> None:
            task.advance(note=outcome.query.group)

        outcomes = run_queries(context.config, seed, config.queries_n, advance)
        second = run_queries(context.config, config.second_seed, config.second_queries_n, advance)
    play_queries(context.view, context.config.scene, outcomes)
    agreement = engine_agreement(outcomes["both_arms"][0].query.scene, config.agreement_states_n, seed)
    repeatable = all(repeats(config, done[0]) for done in outcomes.values())
    carries = failed_carries(context.config, _CARRIES_N)
    held = run_held(context)
    every = [o for done in outcomes.values() for o in done]
    again = [o for done in second.values() for o in done]
    write_csv(folder / "queries.csv", [o.row() for o in every])
    if again:
        write_csv(folder / "queries_second_seed.csv", [o.row() for o in again])
    pairs = [{"first": a, "second": b, "reason": reason} for a, b, reason in acm_report(robot).pairs]
    write_csv(folder / "allowed_collisions.csv", pairs)
    for group, done in outcomes.items():
        trajectory = next((o.result.trajectory for o in done if o.result is not None), None)
        if trajectory is not None:
            trajectory.write_csv(folder / f"trajectory_{group}.csv", robot.joint_names)
            trajectory.write_json(folder / f"trajectory_{group}.json", robot.joint_names, _JSON_EVERY)
    write_paths(folder / "paths.png", context.config.scene, outcomes)
    write_times(outcomes, folder / "times.png", config.time_median_max_s.model_dump())
    checks = [check for group, done in outcomes.items() for check in group_checks(group, done, config)]
    if again:
        for group, done in second.items():
            checks += group_checks(group, done, config, f"second_seed.{group}")
    checks += audit_checks([*every, *again])
    checks += common_checks(agreement, repeatable, len(carries), config)
    checks += held_checks(held, config)
    data = {"groups": _counts(outcomes), "second_seed": _counts(second), "held_moves": held.data()}
    lines = [*notes(first=outcomes, second=second), *carries, *held.notes()]
    return StageResult(checks=checks, data=data, notes=lines)


def group_checks(group: str, outcomes: Sequence[Outcome], config: PlanConfig, name: str | None = None) -> list[Check]:
    """Return the checks of one planning group, prefixed by `name` (default: group)."""
    times = np.array([o.total_s for o in outcomes])
    median, limits = float(np.median(times)), config.time_median_max_s
    blocked_n = sum(o.line_blocked for o in outcomes)
    core_share = sum(o.cpu_s for o in outcomes) / max(1e-9, sum(o.total_s for o in outcomes))
    rows: Rows = {
        "success_rate": (float(np.mean([o.ok for o in outcomes])), ">=", config.success_rate_min),
        "first_plan_median_s": float(np.median([o.scene_s + o.total_s for o in outcomes])),
        "replan_median_s": (median, "<", getattr(limits, group)),
        "replan_p99_s": (float(np.percentile(times, 99)), "<", config.time_p99_max_s),
        "replan_max_s": (float(times.max()), "<", config.time_max_s),
        "core_share": core_share,
        "line_blocked_rate": blocked_n / len(outcomes),
    }
    return worded(
        "plan",
        rows,
        f"{name or group}.",
        core_share=core_share,
        excellent_s=_EXCELLENT_S[group],
        goal_s=_GOAL_S[group],
        reached="reached" if median < _GOAL_S[group] else "missed",
        blocked_n=blocked_n,
        queries_n=len(outcomes),
    )


def audit_checks(outcomes: Sequence[Outcome]) -> list[Check]:
    """Return the audit's checks: dense samples of solved queries must be free."""
    audits = [o.audit for o in outcomes if o.audit is not None]
    rows: Rows = {
        "proof.audited_n": (len(audits), "==", sum(o.ok for o in outcomes)),
        "proof.audit_states": (sum(a.samples_n for a in audits), ">", 0),
        "proof.audit_collisions": (sum(a.collisions_n for a in audits), "==", 0),
        "proof.audit_disagreements": (sum(a.disagreements_n for a in audits), "==", 0),
    }
    return worded("plan", rows)


def common_checks(agreement: float, repeatable: bool, carries_failed_n: int, config: PlanConfig) -> list[Check]:
    """Return the checks common to all groups."""
    rows: Rows = {
        "engines.agreement": (agreement, ">=", config.agreement_min),
        "repeatable": (repeatable, "==", True),
        "closed_chain.carries_rate": (1.0 - carries_failed_n / _CARRIES_N, ">=", config.success_rate_min),
    }
    return worded("plan", rows)


def _counts(outcomes: Outcomes) -> dict[str, Any]:
    counts: dict[str, Any] = {}
    for group, done in outcomes.items():
        solved = [o.result for o in done if o.result is not None]
        counts[group] = {
            "queries_n": len(done),
            "solved_n": len(solved),
            "direct_n": sum(r.direct for r in solved),
            "line_blocked_n": sum(o.line_blocked for o in done),
            "retried_n": sum(r.attempts_n > 1 for r in solved),
        }
    return counts


def notes(**sets: Outcomes) -> list[str]:
    """Return one line per failed query and missed goal."""
    lines = []
    for name, outcomes in sets.items():
        for group, done in outcomes.items():
            lines += [f"{group} query {o.query.index} of the {name} seed failed: {o.message}" for o in done if not o.ok]
            median = float(np.median([o.total_s for o in done])) if done else 0.0
            if median >= _GOAL_S[group]:
                found, goal = f"{median * 1e3:.0f} ms", f"{_GOAL_S[group] * 1e3:.0f} ms"
                lines.append(f"goal missed: the median of {group} ({name} seed) is {found}, goal {goal}")
    return lines
