"""Checks of `plan` from the outcomes of queries, carries and held-object moves."""

from collections.abc import Mapping, Sequence

import numpy as np

from minidual.config.planning import PlanConfig
from minidual.gate.check import Check
from minidual.motion.held.hands import RESIDUAL_MAX_M, RESIDUAL_MAX_RAD
from minidual.skills.held_execution import DrivenMove
from minidual.stages import plan_criteria as criteria
from minidual.trials.planning.evaluate import QueryOutcome
from minidual.trials.planning.held_evaluate import MoveOutcome

CARRIES_N = 5
"""Carries of the task that are planned."""
type Moves = Mapping[str, Sequence[MoveOutcome]]
"""Outcomes of held-object moves by set: `first` and `second` seed."""


def group_checks(
    group: str,
    outcomes: Sequence[QueryOutcome],
    config: PlanConfig,
    prefix: str = "",
) -> list[Check]:
    """Return the checks of one planning group."""
    times_s = np.array([o.total_s for o in outcomes])
    first_times_s = [o.scene_s + o.total_s for o in outcomes]
    success_rate = float(np.mean([o.ok for o in outcomes]))
    median_max_s = getattr(config.time_median_max_s, group)
    core_share = sum(o.cpu_s for o in outcomes) / max(1e-9, sum(o.total_s for o in outcomes))
    blocked_n = sum(o.line_blocked for o in outcomes)
    queries_n = len(outcomes)
    group_prefix = f"{prefix}{group}."
    return [
        criteria.SUCCESS_RATE.check(
            success_rate,
            config.success_rate_min,
            prefix=group_prefix,
        ),
        criteria.FIRST_PLAN_MEDIAN.report(
            float(np.median(first_times_s)),
            prefix=group_prefix,
        ),
        criteria.REPLAN_MEDIAN.check(
            float(np.median(times_s)),
            median_max_s,
            prefix=group_prefix,
            core_share=core_share,
        ),
        criteria.REPLAN_P99.report(
            float(np.percentile(times_s, 99)),
            prefix=group_prefix,
        ),
        criteria.REPLAN_MAX.check(
            float(times_s.max()),
            config.time_max_s,
            prefix=group_prefix,
            core_share=core_share,
        ),
        criteria.CORE_SHARE.report(core_share, prefix=group_prefix),
        criteria.LINE_BLOCKED.report(
            blocked_n / queries_n,
            prefix=group_prefix,
            blocked_n=blocked_n,
            queries_n=queries_n,
        ),
    ]


def common_checks(
    outcomes: Sequence[QueryOutcome],
    agreement: float,
    repeatable: bool,
    carries_failed_n: int,
    config: PlanConfig,
) -> list[Check]:
    """Return the checks of all groups together.

    Args:
        outcomes: Of both seeds; solved ones are audited, and dense samples of them must be free.
        agreement: Share of random states on which the engines agree.
        repeatable: Whether the first queries give the same trajectories again.
        carries_failed_n: Of `CARRIES_N`.
        config: Limits.
    """
    audits = [o.audit for o in outcomes if o.audit is not None]
    solved_n = sum(o.ok for o in outcomes)
    disagreements_n = sum(audit.disagreements_n for audit in audits)
    carries_rate = 1.0 - carries_failed_n / CARRIES_N
    return [
        criteria.AUDITED_N.check(len(audits), solved_n),
        criteria.AUDIT_STATES.check(sum(audit.samples_n for audit in audits), 0),
        criteria.AUDIT_COLLISIONS.check(sum(audit.collisions_n for audit in audits), 0),
        criteria.AUDIT_DISAGREEMENTS.check(disagreements_n, 0),
        criteria.ENGINES_AGREEMENT.check(agreement, config.agreement_min),
        criteria.REPEATABLE.check(repeatable, True),
        criteria.CARRIES_RATE.check(carries_rate, config.success_rate_min),
    ]


def held_checks(outcomes: Moves, driven: Sequence[DrivenMove], config: PlanConfig) -> list[Check]:
    """Return the checks of the held-object moves."""
    held = config.held
    first = outcomes["first"]
    second = outcomes["second"]
    moves = [*first, *second]
    solved = [move for move in moves if move.ok]
    residual_m = _largest([move.residual_m for move in solved])
    residual_rad = _largest([move.residual_rad for move in solved])
    undecided_n = sum(move.move.undecided_n for move in moves)
    unreachable_n = sum(move.move.unreachable_n for move in moves)
    error_m = _largest([drive.error_max_m for drive in driven])
    error_rad = _largest([drive.error_max_rad for drive in driven])
    cpu_time_s = float(np.median([move.cpu_s for move in first]))
    return [
        criteria.HELD_SUCCESS_RATE.check(_solved_share(first), config.success_rate_min),
        criteria.HELD_SECOND_SEED_RATE.check(_solved_share(second), config.success_rate_min),
        criteria.HELD_CPU_TIME_MEDIAN.check(cpu_time_s, held.cpu_time_median_max_s),
        criteria.HELD_TIME_MEDIAN.report(float(np.median([move.total_s for move in first]))),
        criteria.HELD_RESIDUAL_MAX_M.check(residual_m, RESIDUAL_MAX_M),
        criteria.HELD_RESIDUAL_MAX_RAD.check(residual_rad, RESIDUAL_MAX_RAD),
        criteria.HELD_DRAWS_LEFT_OUT.report(
            undecided_n,
            undecided=undecided_n,
            unreachable=unreachable_n,
        ),
        criteria.HELD_DRIVEN_N.check(len(driven), held.executed_n),
        criteria.HELD_ERROR_MAX_M.check(error_m, held.executed_error_max_m),
        criteria.HELD_ERROR_MAX_RAD.check(error_rad, held.executed_error_max_rad),
    ]


def _solved_share(moves: Sequence[MoveOutcome]) -> float:
    return sum(move.ok for move in moves) / len(moves)


def _largest(values: Sequence[float]) -> float:
    """Return the largest value; NaN if one is NaN, or there is none."""
    return float(np.max(values)) if values else np.nan
