"""Benchmark: every method under every condition, from the same starts."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from minidual.config.root import Config
from minidual.config.seeds import stream
from minidual.tasks.task import make_task
from minidual.trials.comparisons import compare_all, compare_with_clean
from minidual.trials.conditions import CLEAN, condition, parse_conditions
from minidual.trials.methods import METHODS, MethodInputs
from minidual.trials.metrics import MethodSummary, TrialMetrics, summarise
from minidual.trials.runner import Watch, run_trials

PURPOSE = "benchmark"
"""Random stream of the starts, used by no earlier stage."""


@dataclass(frozen=True)
class BenchmarkCell:
    """One method under one condition.

    Attributes:
        summary: None where condition or method do not apply.
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
        return not self.why_not and not self.undisturbed and self.summary.trials_n >= self.asked_n

    def record(self) -> dict[str, Any]:
        """Return the cell for a verdict."""
        if self.summary is None:
            return {"applies": False, "why": self.why_not}
        return {"applies": True, **self.summary.record()}

    def row(self) -> dict[str, Any]:
        """Return the cell for CSV."""
        applies = "yes" if self.summary is not None else f"no: {self.why_not}"
        values = {} if self.summary is None else self.summary.to_row()
        return {"method": self.method, "condition": self.condition, "applies": applies, **values}


def trials_asked(config: Config) -> dict[str, dict[str, int]]:
    """Return {task: {condition: trials of each method}}."""
    asked = config.benchmark
    names = parse_conditions(asked.conditions)
    trials_n = {name: asked.trials_n if name == CLEAN else asked.perturbed_trials_n for name in names}
    every = dict.fromkeys(asked.tasks or (config.task,), trials_n)
    further = {} if asked.tasks else asked.further_tasks
    return every | {task: {CLEAN: min(n, asked.trials_n)} for task, n in further.items() if task not in every}


def _why_not(method: str, name: str, inputs: MethodInputs) -> str:
    task = make_task(inputs.config)
    return METHODS[method].cannot(task, inputs.trained or task.name) or condition(name).why_not(method, inputs.config)


def count_trials(methods: Sequence[str], trials_n: Mapping[str, int], inputs: MethodInputs) -> int:
    """Return how many trials `run_benchmark` runs."""
    return sum(n for m in methods for c, n in trials_n.items() if not _why_not(m, c, inputs))


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
    configs = {name: condition(name).config_under(inputs.config) for name in trials_n}
    cells: list[BenchmarkCell] = []
    everything: list[TrialMetrics] = []
    for method in methods:
        for name, n in trials_n.items():
            under = condition(name)
            reason = _why_not(method, name, inputs)
            if reason:
                cells.append(BenchmarkCell(method, name, n, None, reason))
                continue
            rows: list[TrialMetrics] = []
            given, task = replace(inputs, config=configs[name]), make_task(configs[name])
            trials = [task.trial(inputs.seed, purpose, i, widen=under.widen) for i in range(n)]
            for result in run_trials(method, given, trials, workers=workers, condition=name, watch=watch):
                rows.append(result)
                on_trial(result)
            rng = stream(inputs.seed, f"bootstrap/{purpose}/{method}/{name}")
            # Without its push or move, a success is an undisturbed trial.
            missed = tuple(t.index for t in rows if under.act is not None and t.success and t.disturbed is not True)
            cells.append(BenchmarkCell(method, name, n, summarise(rows, rng), undisturbed=missed))
            everything += rows
    return cells, everything


def benchmark_data(cells: Sequence[BenchmarkCell], trials: Sequence[TrialMetrics], seed: int) -> dict[str, Any]:
    """Return one task's part of the verdict."""
    return {
        "methods": {c.method: c.record() for c in cells if c.condition == CLEAN},
        "conditions": conditions_data(cells),
        "comparisons": compare_all(trials, seed),
        "losses": compare_with_clean(trials, seed),
    }


def conditions_data(cells: Sequence[BenchmarkCell]) -> dict[str, Any]:
    """Return {condition: {summary, trials_n, methods}} without the clean cells."""
    table: dict[str, Any] = {}
    for cell in cells:
        if cell.condition != CLEAN:
            entry = {"summary": condition(cell.condition).summary, "trials_n": cell.asked_n, "methods": {}}
            table.setdefault(cell.condition, entry)["methods"][cell.method] = cell.record()
    return table
