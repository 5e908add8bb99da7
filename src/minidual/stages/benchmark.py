"""`minidual benchmark`: all methods on the same task, with and without disturbances."""

from collections.abc import Mapping, Sequence
from typing import Any

from minidual.demos.quality import JERK_FILTER
from minidual.durable import write_csv
from minidual.gate.check import Check, Rows
from minidual.gate.stage import StageContext, StageResult
from minidual.show.figures.film import draw_failures
from minidual.show.watch import watch_trials
from minidual.stages.deploy import recorded_task
from minidual.stages.words import worded
from minidual.tasks.catalogue import tasks_of
from minidual.trials import benchmark
from minidual.trials.conditions import CLEAN
from minidual.trials.methods import METHODS, MethodInputs, check_able
from minidual.trials.metrics import MethodSummary, TrialMetrics

_REPORTED = (
    "duration_median_s",
    "torque_ratio_max",
    "jerk_rms_median",
    "tilt_max_rad",
    "path_length_m",
)


def benchmark_checks(
    summaries: Sequence[MethodSummary],
    success_rate_min: Mapping[str, float],
    asked_n: int,
    prefix: str = "",
) -> list[Check]:
    """Return the checks of the undisturbed trials.

    Limits: trial counts, and success rates where configured.
    """
    checks: list[Check] = []
    for s in summaries:
        rows: Rows = {"success_rate": (s["success_rate"], ">", success_rate_min.get(s.method))}
        rows = {**rows, **{name: s[name] for name in _REPORTED}}
        checks += worded(
            "benchmark",
            rows,
            f"{prefix}{s.method}.",
            interval=s.interval,
            jerk_filter=JERK_FILTER,
        )
    evaluated = min((s.trials_n for s in summaries), default=0)
    return checks + worded("benchmark", {"trials_per_method": (evaluated, ">=", asked_n)}, prefix)


def condition_checks(
    cells: Sequence[benchmark.BenchmarkCell],
    methods: Sequence[str],
    conditions: Sequence[str],
    prefix: str = "",
) -> list[Check]:
    """Return the checks of the methods-by-conditions table.

    It must be complete and finite; disturbed success has no limit.
    """
    known = {(c.method, c.condition): c for c in cells}
    asked = [(m, c) for m in methods for c in conditions]
    holes: list[str] = []
    for m, c in asked:
        cell = known.get((m, c))
        if cell is None or not cell.settled:
            missed = (
                f" (trial {cell.undisturbed[0]} succeeded undisturbed)"
                if cell and cell.undisturbed
                else ""
            )
            holes.append(f"{m} under {c}{missed}")
    missing = [
        f"{c.method} under {c.condition}: {name}"
        for c in cells
        if c.summary
        for name in c.summary.not_finite()
    ]
    n = len(asked)
    rows: Rows = {
        "cells_settled": (n - len(holes), "==", n),
        "cells_not_finite": (len(missing), "==", 0),
    }
    checks = worded("benchmark", rows, prefix, holes=_first(holes), missing=_first(missing))
    for cell in cells:
        if cell.summary is not None and cell.condition != CLEAN:
            name = f"{prefix}{cell.method}.{cell.condition.replace(' ', '_')}.success_rate"
            checks.append(Check(name, cell.summary["success_rate"], why=cell.summary.interval))
    return checks


def _first(names: Sequence[str]) -> str:
    return f": {', '.join(names[:6])}" if names else ""


def run(context: StageContext) -> StageResult:
    """Run all trials and write the tables."""
    config = context.config.benchmark
    seed = context.seed
    folder = context.folder
    methods = METHODS.names(config.methods)
    asked = benchmark.trials_asked(context.config)
    trained = context.upstream.get("train-act")
    tasks = tasks_of(context.config)
    checkpoint = trained and trained / "checkpoint"
    recorded = context.upstream.get("teleop-record")
    of = recorded_task(recorded) if recorded else ""
    for name in methods:
        check_able(name, tasks.values(), of)
    inputs = {name: MethodInputs(task.config, seed, checkpoint, of) for name, task in tasks.items()}
    count = sum(
        benchmark.count_trials(methods, asked[task], given) for task, given in inputs.items()
    )
    checks = list[Check]()
    data = dict[str, Any]()
    watch = watch_trials(context.view)
    captions: dict[str, str] = {}
    tables: dict[str, list[dict[str, Any]]] = {"benchmark": [], "methods": [], "conditions": []}
    with context.progress.task("benchmark trials", count) as progress:
        for task, given in inputs.items():

            def tell(result: TrialMetrics, task: str = task) -> None:
                progress.advance(note=f"{task}, {result.method}, {result.condition}")

            trials_n = asked[task]
            cells, trials = benchmark.run_benchmark(
                methods,
                trials_n,
                given,
                workers=context.workers,
                on_trial=tell,
                watch=watch,
            )
            clean = [c.summary for c in cells if c.condition == CLEAN and c.summary is not None]
            prefix = f"{task}." if len(tasks) > 1 else ""
            checks += benchmark_checks(clean, config.success_rate_min, trials_n[CLEAN], prefix)
            checks += condition_checks(cells, methods, tuple(trials_n), prefix)
            data[task] = benchmark.benchmark_data(cells, trials, seed)
            if lost := benchmark.first_failures(trials):
                name = f"failures-{task}.png"
                captions[name] = f"{task}: failed trials, the first of each kind"
                drawn = [
                    (given, benchmark.draw_under(given, t.condition)(t.index), t) for t in lost
                ]
                draw_failures(drawn, folder / name)
            tables["benchmark"] += [{"task": task, **t.to_row()} for t in trials]
            tables["methods"] += [{"task": task, **s.to_row()} for s in clean]
            tables["conditions"] += [{"task": task, **c.row()} for c in cells]
    for name, rows in tables.items():
        write_csv(folder / f"{name}.csv", rows, missing="does not apply")
    return StageResult(checks=checks, data={"tasks": data, "captions": captions})
