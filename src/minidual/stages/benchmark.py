"""`minidual benchmark`: all methods on the same task, with and without disturbances."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from minidual.demos.quality import JERK_FILTER
from minidual.durable import read_json, write_csv
from minidual.gate.check import Check
from minidual.gate.criterion import Criterion
from minidual.gate.stage import StageContext, StageResult
from minidual.policies.architectures import architecture
from minidual.show.figures.film import draw_failures
from minidual.show.watch import watch_trials
from minidual.stages.benchmark_films import film_jobs, write_films
from minidual.stages.checkpoint_choice import recorded_task
from minidual.stages.policy_folders import outside_policies
from minidual.tasks.catalogue import tasks_of
from minidual.trials import benchmark
from minidual.trials.compared import benchmark_methods
from minidual.trials.conditions import CLEAN
from minidual.trials.methods import (
    METHODS,
    MethodInputs,
    TrainedPolicy,
    check_able,
)
from minidual.trials.metrics import MethodSummary, TrialMetrics
from minidual.trials.trial_table import Series, count_results

_NAMES_SHOWN = 6
"""Most names of missing cells or numbers in a message."""

SUCCESS_RATE = Criterion(
    "success_rate",
    ">",
    why="{interval}",
    remedy="benchmark.csv names what failed first in each trial",
)
REPORTED = (
    Criterion(
        "duration_median_s",
        unit="s",
        why="median over successful trials, start to released at rest",
    ),
    Criterion("torque_ratio_max", why="largest motor torque over its limit, all trials"),
    Criterion("jerk_rms_median", unit="rad/s^3", why=JERK_FILTER),
    Criterion(
        "tilt_max_rad",
        unit="rad",
        why="largest tilt of the object, all trials, failed ones too",
    ),
    Criterion(
        "path_length_m",
        unit="m",
        why="median path of a hand, mean of the two, over successful trials",
    ),
)
"""Numbers of a method's summary that have no limit."""
TRIALS_PER_METHOD = Criterion(
    "trials_per_method",
    ">=",
    why="results in benchmark.csv, each index once, of the method that has the fewest; "
    "rows of different lengths cannot be compared",
    remedy="minidual benchmark --force runs them all",
)
CELLS_SETTLED = Criterion(
    "cells_settled",
    "==",
    why="benchmark.csv holds all trials of every method and condition, each push and move took place "
    "in those that succeeded, or there is a reason why it does not apply{holes}",
    remedy="minidual benchmark --force",
)
CELLS_NOT_FINITE = Criterion(
    "cells_not_finite",
    "==",
    why="numbers that the trials should have given, and that do not exist{missing}",
    remedy="benchmark.csv names what failed first in each trial",
)


def benchmark_checks(
    summaries: Sequence[MethodSummary],
    success_rate_min: Mapping[str, float],
    trials_n: int,
    results_n: Mapping[str, int],
    prefix: str = "",
) -> list[Check]:
    """Return the checks of the undisturbed trials.

    Args:
        summaries: One of each method.
        success_rate_min: {method: limit}; rates of other methods are reported.
        trials_n: Trials that each method was asked for.
        results_n: {method: results read back}.
        prefix: Prefix of the checks' names.
    """
    checks: list[Check] = []
    for summary in summaries:
        own_prefix = f"{prefix}{summary.method}."
        rate_check = SUCCESS_RATE.check(
            summary["success_rate"],
            success_rate_min.get(summary.method),
            prefix=own_prefix,
            interval=summary.interval,
        )
        checks.append(rate_check)
        checks += [
            criterion.report(summary[criterion.name], prefix=own_prefix) for criterion in REPORTED
        ]
    least_n = min((results_n.get(summary.method, 0) for summary in summaries), default=0)
    checks.append(TRIALS_PER_METHOD.check(least_n, trials_n, prefix=prefix))
    return checks


def condition_checks(
    cells: Sequence[benchmark.BenchmarkCell],
    methods: Sequence[str],
    conditions: Sequence[str],
    results_n: Mapping[Series, int],
    prefix: str = "",
) -> list[Check]:
    """Return the checks of the methods-by-conditions table.

    It must be complete and finite; disturbed success has no limit.

    Args:
        cells: Of one task.
        methods: Rows of the table.
        conditions: Columns of the table.
        results_n: Results of the task that were read back; without its name.
        prefix: Prefix of the checks' names.
    """
    holes = _holes(cells, methods, conditions, results_n)
    missing = [
        f"{cell.method} under {cell.condition}: {name}"
        for cell in cells
        if cell.summary
        for name in cell.summary.not_finite()
    ]
    cells_n = len(methods) * len(conditions)
    checks = [
        CELLS_SETTLED.check(cells_n - len(holes), cells_n, prefix=prefix, holes=_listed(holes)),
        CELLS_NOT_FINITE.check(len(missing), 0, prefix=prefix, missing=_listed(missing)),
    ]
    for cell in cells:
        if cell.summary is not None and cell.condition != CLEAN:
            condition = cell.condition.replace(" ", "_")
            name = f"{prefix}{cell.method}.{condition}.success_rate"
            checks.append(Check(name, cell.summary["success_rate"], why=cell.summary.interval))
    return checks


def _holes(
    cells: Sequence[benchmark.BenchmarkCell],
    methods: Sequence[str],
    conditions: Sequence[str],
    results_n: Mapping[Series, int],
) -> list[str]:
    """Return the cells of the table that are missing or not settled, in words."""
    table = {(cell.method, cell.condition): cell for cell in cells}
    holes: list[str] = []
    for method in methods:
        for condition in conditions:
            cell = table.get((method, condition))
            if cell is None:
                holes.append(f"{method} under {condition}")
                continue
            read_n = results_n.get(Series(method, condition), 0)
            complete = cell.summary is None or read_n >= cell.asked_n
            if not cell.settled or not complete:
                holes.append(f"{method} under {condition}{_hole(cell, read_n)}")
    return holes


def _hole(cell: benchmark.BenchmarkCell, read_n: int) -> str:
    """Return what is missing to settle a cell."""
    if cell.undisturbed:
        return f" (trial {cell.undisturbed[0]} succeeded undisturbed)"
    if cell.summary is not None and read_n < cell.asked_n:
        return f" ({read_n} of {cell.asked_n} results)"
    return ""


def _listed(names: Sequence[str]) -> str:
    return f": {', '.join(names[:_NAMES_SHOWN])}" if names else ""


class _TaskCells(NamedTuple):
    """The cells of a task.

    Attributes:
        trials_n: {condition: trials of each method}.
        prefix: Prefix of the names of its checks.
    """

    task: str
    trials_n: Mapping[str, int]
    cells: Sequence[benchmark.BenchmarkCell]
    prefix: str

    @property
    def clean(self) -> list[MethodSummary]:
        """Summaries of the undisturbed trials."""
        return [c.summary for c in self.cells if c.condition == CLEAN and c.summary is not None]


class _Results:
    """Rows of the tables and records of the tasks so far.

    Attributes:
        data: {task: record}.
        captions: {figure: caption}.
        tables: {name of the .csv: rows}.
    """

    def __init__(self, context: StageContext) -> None:
        self._context = context
        self._tasks: list[_TaskCells] = []
        self.data: dict[str, Any] = {}
        self.captions: dict[str, str] = {}
        self.tables: dict[str, list[dict[str, Any]]] = {
            "benchmark": [],
            "methods": [],
            "conditions": [],
        }

    def add(
        self,
        inputs: MethodInputs,
        trials_n: Mapping[str, int],
        cells: Sequence[benchmark.BenchmarkCell],
        trials: Sequence[TrialMetrics],
        prefix: str,
    ) -> None:
        """Add the results of a task; `trials_n`: {condition: trials of each method}."""
        task = inputs.config.task
        task_cells = _TaskCells(task, trials_n, cells, prefix)
        self._tasks.append(task_cells)
        self.data[task] = benchmark.benchmark_data(cells, trials, self._context.seed)
        self._draw_failures(inputs, trials)
        self.tables["benchmark"] += [{"task": task, **t.to_row()} for t in trials]
        self.tables["methods"] += [{"task": task, **s.to_row()} for s in task_cells.clean]
        self.tables["conditions"] += [{"task": task, **c.row()} for c in cells]

    def write(self) -> list[Check]:
        """Write the tables; return the checks of all tasks, with what benchmark.csv holds."""
        folder = self._context.folder
        for name, rows in self.tables.items():
            write_csv(folder / f"{name}.csv", rows, missing="does not apply")
        written = count_results(folder / "benchmark.csv")
        checks: list[Check] = []
        for task_cells in self._tasks:
            checks += self._task_checks(task_cells, written)
        return checks

    def _task_checks(self, task_cells: _TaskCells, written: Mapping[Series, int]) -> list[Check]:
        config = self._context.config.benchmark
        results_n = {
            Series(series.method, series.condition): count
            for series, count in written.items()
            if series.task == task_cells.task
        }
        clean_n = {
            series.method: count for series, count in results_n.items() if series.condition == CLEAN
        }
        trials_n = task_cells.trials_n
        prefix = task_cells.prefix
        return [
            *benchmark_checks(
                task_cells.clean,
                config.success_rate_min,
                trials_n[CLEAN],
                clean_n,
                prefix,
            ),
            *condition_checks(
                task_cells.cells,
                METHODS.names(config.methods),
                tuple(trials_n),
                results_n,
                prefix,
            ),
        ]

    def _draw_failures(self, inputs: MethodInputs, trials: Sequence[TrialMetrics]) -> None:
        """Draw the first failed trial of each kind, if there are any."""
        task = inputs.config.task
        failures = benchmark.first_failures(trials)
        if not failures:
            return
        drawn = [
            (inputs, benchmark.draw_under(inputs, failed.condition)(failed.index), failed)
            for failed in failures
        ]
        name = f"failures-{task}.png"
        self.captions[name] = f"{task}: failed trials, the first of each kind"
        draw_failures(drawn, self._context.folder / name)


def run(context: StageContext) -> StageResult:
    """Run all trials and write the tables."""
    methods = benchmark_methods(context.config)
    trials_n = benchmark.trials_asked(context.config)
    inputs = _method_inputs(context, methods)
    watch = watch_trials(context.view)
    results = _Results(context)
    trials_of: dict[str, list[TrialMetrics]] = {}
    count = sum(
        benchmark.count_trials(methods, trials_n[task], task_inputs)
        for task, task_inputs in inputs.items()
    )
    with context.progress.task("benchmark trials", count) as progress:
        for task, task_inputs in inputs.items():

            def advance(result: TrialMetrics, task: str = task) -> None:
                progress.advance(note=f"{task}, {result.method}, {result.condition}")

            cells, trials = benchmark.run_benchmark(
                methods,
                trials_n[task],
                task_inputs,
                workers=context.workers,
                on_trial=advance,
                watch=watch,
            )
            prefix = f"{task}." if len(inputs) > 1 else ""
            results.add(task_inputs, trials_n[task], cells, trials, prefix)
            trials_of[task] = trials
    if context.config.benchmark.films:
        jobs = film_jobs(inputs, methods, trials_of)
        results.captions.update(write_films(context, jobs))
    checks = results.write()
    data = {"tasks": results.data, "captions": results.captions}
    notes = [*network_notes(context, methods), *title_notes(methods, list(trials_of))]
    return StageResult(checks=checks, data=data, notes=notes)


def network_notes(context: StageContext, methods: Sequence[str]) -> list[str]:
    """Name the network behind each method that drives the trained policy."""
    trained = context.upstream.get("train-act")
    named = context.config.benchmark.policies
    learned = [
        name
        for name in methods
        if METHODS[name].learned and _of_the_run(name) and name not in named
    ]
    if trained is None or not learned:
        return []
    network = architecture(read_json(trained / "train.json").get("architecture", "unknown"))
    summary = f": {network.summary}" if network.summary else ""
    return [f"{name} drives {network.name}{summary}" for name in learned]


def title_notes(methods: Sequence[str], tasks: Sequence[str]) -> list[str]:
    """Say where the policy of a method drives only a part of a task."""
    return [
        f"{method} on {task} is {METHODS[method].title(task)}"
        for method in methods
        for task in tasks
        if METHODS[method].title(task)
    ]


def _method_inputs(context: StageContext, methods: Sequence[str]) -> dict[str, MethodInputs]:
    """Return the inputs of the methods for each task.

    Raises:
        UsageError: A method cannot do one of the tasks.
    """
    tasks = tasks_of(context.config)
    trained = context.upstream.get("train-act")
    recorded = context.upstream.get("teleop-record")
    checkpoint = trained / "checkpoint" if trained is not None else None
    policy_task = recorded_task(recorded) if recorded is not None else ""
    named = context.config.benchmark.policies
    own: dict[str, TrainedPolicy] = {}
    if checkpoint is not None:
        own = {
            method: TrainedPolicy(checkpoint, policy_task)
            for method in methods
            if METHODS[method].learned and _of_the_run(method) and method not in named
        }
    inputs: dict[str, MethodInputs] = {}
    for name, task in tasks.items():
        policies = {**own, **outside_policies(context.config, name)}
        inputs[name] = MethodInputs(task.config, context.seed, policies=policies)
    for method in methods:
        trained_on = own[method].task if method in own else ""
        check_able(method, tasks.values(), trained_on)
    return inputs


def _of_the_run(method: str) -> bool:
    """Return whether the stage `train-act` trains a method's policy."""
    return METHODS[method].trainer is None
