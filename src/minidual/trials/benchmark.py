"""Benchmark: every method under every condition, from the same starts."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from minidual.config.root import Config
from minidual.config.seeds import stream
from minidual.errors import UsageError
from minidual.tasks.catalogue import TASKS, make_task
from minidual.tasks.task import Trial
from minidual.trials.comparisons import compare_all, compare_with_clean
from minidual.trials.conditions import CLEAN, CONDITIONS, condition, parse_conditions
from minidual.trials.contrasts import contrast_all
from minidual.trials.methods import METHODS, MethodInputs
from minidual.trials.metrics import Cell, MethodSummary, TrialMetrics, summarise
from minidual.trials.runner import Watch, run_trials

PURPOSE = "benchmark"
"""Random stream of the starts, used by no earlier stage."""
PERTURBED = "perturb"
"""Random stream of the starts of `robustness`, used by no other stage."""
TRY = "try"
"""Random stream of the starts of `try` and of `minidual.run_trials`, used by no stage."""
DISTURBED_RATE_MIN = 0.95
"""Least success rate of a carry under each promised condition."""
FAILURES_MAX = 3
"""Failed trials of a task that are drawn."""

type Draw = Callable[[int], Trial]
"""Returns the trial of an index."""


class BenchmarkCell(NamedTuple):
    """One method under one condition.

    Attributes:
        asked_n: Trials that were asked for.
        summary: None where condition or method do not apply.
        why_not: Why they do not.
        undisturbed: Trials that succeeded without their push or move.
    """

    method: str
    condition: str
    asked_n: int
    summary: MethodSummary | None
    why_not: str = ""
    undisturbed: tuple[int, ...] = ()

    @property
    def settled(self) -> bool:
        """Whether it has all its trials, each disturbed, or a reason for none."""
        if self.summary is None:
            return bool(self.why_not)
        complete = self.summary.trials_n >= self.asked_n
        return complete and not self.why_not and not self.undisturbed

    def record(self) -> dict[str, Any]:
        """Return the cell for a verdict."""
        if self.summary is None:
            return {"applies": False, "why": self.why_not}
        return {"applies": True, **self.summary.record()}

    def row(self) -> dict[str, Cell]:
        """Return the cell for CSV."""
        labels: dict[str, Cell] = {"method": self.method, "condition": self.condition}
        if self.summary is None:
            return {**labels, "applies": f"no: {self.why_not}"}
        return {**labels, "applies": "yes", **self.summary.to_row()}


def trials_asked(config: Config) -> dict[str, dict[str, int]]:
    """Return {task: {condition: trials of each method}}."""
    settings = config.benchmark
    conditions = parse_conditions(settings.conditions)
    more = _condition_trials(config)
    trials_n: dict[str, dict[str, int]] = {}
    for task in settings.tasks or (config.task,):
        trials_n[task] = {
            name: max(settings.perturbed_trials_n, more.get(name, {}).get(task, 0))
            for name in conditions
        }
        trials_n[task][CLEAN] = settings.trials_n
    if settings.tasks:
        return trials_n
    for task, clean_n in settings.further_tasks.items():
        if task not in trials_n:
            trials_n[task] = {CLEAN: min(clean_n, settings.trials_n)}
            for name in conditions:
                if task in more.get(name, {}):
                    trials_n[task][name] = more[name][task]
    return trials_n


def _condition_trials(config: Config) -> dict[str, Mapping[str, int]]:
    """Return `benchmark.condition_trials` by the conditions' own names.

    Raises:
        UsageError: Unknown condition or task, or `clean`, which has settings of its own.
    """
    trials_n: dict[str, Mapping[str, int]] = {}
    for typed_name, by_task in config.benchmark.condition_trials.items():
        name = condition(typed_name).name
        if name == CLEAN:
            raise UsageError(
                "benchmark.condition_trials names 'clean', whose trials have settings of their own",
                remedy="benchmark.trials_n, and benchmark.further_tasks for the other tasks",
            )
        TASKS.names(tuple(by_task))
        trials_n[name] = by_task
    return trials_n


def _why_not(method: str, name: str, inputs: MethodInputs) -> str:
    """Return why a method has no trials under a condition, or ""."""
    own = inputs.of(method)
    spec = METHODS[method]
    cannot = spec.cannot(make_task(inputs.config), own.trained)
    if cannot:
        return cannot
    if spec.learned and own.checkpoint is None:
        return "it has no policy for the task"
    return condition(name).why_not(method, inputs.config)


def count_trials(methods: Sequence[str], trials_n: Mapping[str, int], inputs: MethodInputs) -> int:
    """Return how many trials `run_benchmark` runs."""
    return sum(
        count
        for method in methods
        for name, count in trials_n.items()
        if not _why_not(method, name, inputs)
    )


def draw_under(inputs: MethodInputs, name: str, purpose: str = PURPOSE) -> Draw:
    """Return the draw of a condition's trials."""
    row = condition(name)
    task = make_task(row.config_under(inputs.config))
    return lambda index: task.trial(inputs.seed, purpose, index, widen=row.widen)


def first_failures(trials: Sequence[TrialMetrics]) -> list[TrialMetrics]:
    """Return the first failed trial of each method and kind of failure, clean ones first.

    They are `FAILURES_MAX` at most.
    """
    failed = [trial for trial in trials if not trial.success]
    failed.sort(key=lambda trial: trial.condition != CLEAN)
    first: dict[tuple[str, str], TrialMetrics] = {}
    for trial in failed:
        first.setdefault((trial.method, trial.failure), trial)
    return list(first.values())[:FAILURES_MAX]


def run_benchmark(
    methods: Sequence[str],
    trials_n: Mapping[str, int],
    inputs: MethodInputs,
    *,
    workers: int,
    purpose: str = PURPOSE,
    on_trial: Callable[[TrialMetrics], None] = lambda result: None,
    watch: Watch | None = None,
) -> tuple[list[BenchmarkCell], list[TrialMetrics]]:
    """Run every method under every condition, {condition: trials} each.

    A cell depends only on configuration, seed, method, condition and number of trials.

    Raises:
        UsageError: A condition sets a value out of bounds; before the first trial.
    """
    draws = {name: draw_under(inputs, name, purpose) for name in trials_n}
    first = inputs.config.benchmark.first_start if purpose == PURPOSE else 0
    cells: list[BenchmarkCell] = []
    results: list[TrialMetrics] = []
    for method in methods:
        for name, count in trials_n.items():
            reason = _why_not(method, name, inputs)
            if reason:
                cells.append(BenchmarkCell(method, name, count, None, reason))
                continue
            trials = [draws[name](index) for index in range(first, first + count)]
            rows: list[TrialMetrics] = []
            for result in run_trials(
                method,
                inputs,
                trials,
                workers=workers,
                condition=name,
                watch=watch,
            ):
                rows.append(result)
                on_trial(result)
            rng = stream(inputs.seed, f"bootstrap/{purpose}/{method}/{name}")
            summary = summarise(rows, rng)
            undisturbed = _undisturbed(name, rows)
            cells.append(
                BenchmarkCell(method, name, count, summary, undisturbed=undisturbed),
            )
            results += rows
    return cells, results


def _undisturbed(name: str, trials: Sequence[TrialMetrics]) -> tuple[int, ...]:
    """Return the trials that succeeded although their push or move did not take place."""
    if condition(name).act is None:
        return ()
    return tuple(trial.index for trial in trials if trial.success and trial.disturbed is not True)


def benchmark_data(
    cells: Sequence[BenchmarkCell],
    trials: Sequence[TrialMetrics],
    seed: int,
) -> dict[str, Any]:
    """Return one task's part of the verdict."""
    return {
        "methods": {cell.method: cell.record() for cell in cells if cell.condition == CLEAN},
        "conditions": conditions_data(cells),
        "comparisons": compare_all(trials, seed),
        "contrasts": [contrast.to_row() for contrast in contrast_all(trials, seed)],
        "losses": compare_with_clean(trials, seed),
    }


def conditions_data(cells: Sequence[BenchmarkCell]) -> dict[str, Any]:
    """Return {condition: {summary, trials_n, methods}} without the clean cells."""
    table: dict[str, Any] = {}
    for cell in cells:
        if cell.condition == CLEAN:
            continue
        if cell.condition not in table:
            table[cell.condition] = {
                "summary": condition(cell.condition).summary,
                "trials_n": cell.asked_n,
                "methods": {},
            }
        table[cell.condition]["methods"][cell.method] = cell.record()
    return table


def promised(trials_n: int) -> dict[str, int]:
    """Return {condition: trials} of the conditions that a carry must pass, clean first."""
    return {name: trials_n for name, row in CONDITIONS.items() if row.promised}


def limits_of(config: Config, task: str, method: str, name: str) -> str:
    """Return the limit that the product promises for a cell, as text, or ""."""
    if name == CLEAN:
        least = config.benchmark.success_rate_min.get(method)
        return "" if least is None else f"more than {100 * least:.0f} %"
    if method == "impedance" and task == "rod_carry" and CONDITIONS[name].promised:
        return f"{100 * DISTURBED_RATE_MIN:.0f} % or more (carry --perturb)"
    least = config.deploy.condition_rate_min.get(name)
    if least and method == "act" and task == config.task:
        return f"{100 * least:.0f} % or more (deploy)"
    return ""
