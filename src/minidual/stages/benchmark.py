"""`minidual benchmark`: all methods on the same task, with and without disturbances."""

from __future__ import annotations

from collections.abc import Sequence

from minidual.config.evaluation import BenchmarkConfig
from minidual.demos.smoothness import JERK_FILTER
from minidual.gate.check import Check
from minidual.gate.stage import StageContext, StageResult
from minidual.show.watch import watch_trials
from minidual.trials.benchmark import (
    BenchmarkCell,
    conditions_data,
    count_trials,
    run_benchmark,
    summaries,
    write_cells,
)
from minidual.trials.comparisons import compare_all, compare_with_clean
from minidual.trials.conditions import CLEAN, parse_conditions
from minidual.trials.methods import MethodInputs, parse_methods
from minidual.trials.metrics import MethodSummary
from minidual.trials.runner import TrialResult
from minidual.trials.tables import write_csv, write_json

_UNITS = {
    "duration_median_s": ("s", "median over successful trials, start to released at rest"),
    "torque_ratio_max": ("", "largest motor torque over its limit, all trials"),
    "jerk_rms_median": ("rad/s^3", JERK_FILTER),
    "tilt_max_rad": ("rad", "largest tilt of the object, all trials, failed ones too"),
    "path_length_m": ("m", "median path of a hand, mean of the two, over successful trials"),
}


def benchmark_checks(summaries: Sequence[MethodSummary], config: BenchmarkConfig) -> list[Check]:
    """Return the checks of the undisturbed trials.

    Only trial counts and success rates have limits; the latter only where configured.
    """
    checks = []
    for summary in summaries:
        limit = config.success_rate_min.get(summary.method)
        checks.append(
            Check(
                f"{summary.method}.success_rate",
                summary.success_rate,
                None if limit is None else ">",
                limit,
                "",
                _interval(summary),
                "benchmark.csv names what failed first in each trial",
            )
        )
        for name, (unit, why) in _UNITS.items():
            checks.append(Check(f"{summary.method}.{name}", getattr(summary, name), unit=unit, why=why))
    evaluated = min((s.trials_n for s in summaries), default=0)
    checks.append(
        Check(
            "trials_per_method",
            evaluated,
            ">=",
            config.trials_n,
            "",
            "every method must have run every trial, or the rows cannot be compared",
        )
    )
    return checks


def condition_checks(cells: Sequence[BenchmarkCell], methods: Sequence[str], conditions: Sequence[str]) -> list[Check]:
    """Return the checks of the methods-by-conditions table.

    The table must be complete and finite. Disturbed success has no limit.
    """
    settled = {(c.method, c.condition) for c in cells if c.settled}
    asked = [(m, c) for m in methods for c in conditions]
    missed = {(c.method, c.condition): c.undisturbed for c in cells if c.undisturbed}
    open_cells = [
        f"{m} under {c}" + (f" (trial {missed[m, c][0]} succeeded undisturbed)" if (m, c) in missed else "")
        for m, c in asked
        if (m, c) not in settled
    ]
    holes = [f"{c.method} under {c.condition}: {name}" for c in cells for name in c.not_finite()]
    checks = [
        Check(
            "cells_settled",
            len(asked) - len(open_cells),
            "==",
            len(asked),
            "",
            "every method has all its trials under every condition, each push and move took place in those that succeeded, or "
            "there is a reason why it does not apply" + (f"; open: {', '.join(open_cells[:6])}" if open_cells else ""),
            "minidual benchmark --force",
        ),
        Check(
            "cells_not_finite",
            len(holes),
            "==",
            0,
            "",
            "numbers that the trials should have given, and that do not exist"
            + (f": {', '.join(holes[:6])}" if holes else ""),
            "benchmark.csv names what failed first in each trial",
        ),
    ]
    for cell in cells:
        if cell.summary is not None and cell.condition != conditions[0]:
            name = f"{cell.method}.{cell.condition.replace(' ', '_')}.success_rate"
            checks.append(Check(name, cell.summary.success_rate, why=_interval(cell.summary)))
    return checks


def _interval(summary: MethodSummary) -> str:
    return (
        f"{summary.successes_n} of {summary.trials_n} trials, 95 % Wilson interval "
        f"{summary.success_low:.3f} to {summary.success_high:.3f}"
    )


def run(context: StageContext) -> StageResult:
    """Run all trials and write the tables."""
    config, seed, folder = context.config.benchmark, context.seed, context.folder
    methods, conditions = parse_methods(config.methods), parse_conditions(config.conditions)
    inputs = MethodInputs(context.config, seed, context.upstream["train-act"] / "checkpoint")
    trials_n = {name: config.trials_n if name == CLEAN else config.perturbed_trials_n for name in conditions}
    with context.progress.task("benchmark trials", count_trials(methods, trials_n, context.config)) as task:

        def on_trial(result: TrialResult) -> None:
            task.advance(note=f"{result.metrics.method}, {result.metrics.condition}")

        cells, trials = run_benchmark(
            methods, trials_n, inputs, workers=context.workers, on_trial=on_trial, watch=watch_trials(context.view)
        )
    clean = summaries(cells)
    table = conditions_data(cells)
    write_csv(folder / "benchmark.csv", trials)
    write_csv(folder / "methods.csv", clean)
    write_cells(folder / "conditions.csv", cells)
    write_json(
        folder / "benchmark.json",
        [c.summary for c in cells if c.summary is not None],
        trials,
        {"seed": seed, "conditions": table},
        seed=seed,
    )
    return StageResult(
        checks=benchmark_checks(clean, config) + condition_checks(cells, methods, conditions),
        data={
            "methods": {c.method: c.record() for c in cells if c.condition == CLEAN},
            "conditions": table,
            "comparisons": compare_all(trials, seed),
            "losses": compare_with_clean(trials, seed),
            "jerk_filter": JERK_FILTER,
        },
    )
