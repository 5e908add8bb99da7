"""Benchmark: every method under every condition, from the same starts."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from minidual.config.root import Config
from minidual.config.seeds import stream
from minidual.tasks.task import make_task
from minidual.trials.conditions import CLEAN, condition
from minidual.trials.methods import MethodInputs
from minidual.trials.metrics import MethodSummary, TrialMetrics, summarise
from minidual.trials.runner import TrialResult, Watch, run_trials
from minidual.trials.tables import write_rows

PURPOSE = "benchmark"
"""Random stream of the starts, used by no earlier stage."""

OVER_SUCCESSES = ("duration_", "path_", "internal_", "pinch_")
"""Prefixes of numbers that need a success."""


@dataclass(frozen=True)
class BenchmarkCell:
    """One method under one condition.

    Attributes:
        asked_n: Trials requested.
        summary: None where the condition does not apply.
        undisturbed: Successes in which the push or move never took place.
    """

    method: str
    condition: str
    asked_n: int
    summary: MethodSummary | None
    why_not: str = ""
    undisturbed: tuple[int, ...] = ()

    @property
    def settled(self) -> bool:
        """Whether it has all its trials, disturbed, or a reason for none."""
        if self.summary is None:
            return bool(self.why_not)
        return not self.why_not and not self.undisturbed and self.summary.trials_n >= self.asked_n

    def not_finite(self) -> list[str]:
        """Return names of numbers that should be finite and are not."""
        s = self.summary
        if s is None:
            return []
        names = [f.name for f in fields(s) if isinstance(getattr(s, f.name), float)]
        due = [n for n in names if s.successes_n > 0 or not n.startswith(OVER_SUCCESSES)]
        return [n for n in due if not math.isfinite(getattr(s, n))]

    def record(self) -> dict[str, Any]:
        """Return JSON types; NaN becomes "nan"."""
        if self.summary is None:
            return {"applies": False, "why": self.why_not}
        kept = ("method", "condition", "trials_n", "failures")
        values = {k: v for k, v in self.summary.__dict__.items() if k not in kept}
        plain = {k: "nan" if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}
        return {"applies": True, "trials": self.summary.trials_n, **plain, "failures": dict(self.summary.failures)}


def count_trials(methods: Sequence[str], trials_n: Mapping[str, int], config: Config) -> int:
    """Return how many trials `run_benchmark` runs."""
    return sum(n for m in methods for c, n in trials_n.items() if not condition(c).why_not(m, config))


def run_benchmark(
    methods: Sequence[str],
    trials_n: Mapping[str, int],
    inputs: MethodInputs,
    *,
    workers: int,
    purpose: str = PURPOSE,
    on_trial: Callable[[TrialResult], None] | None = None,
    watch: Watch | None = None,
) -> tuple[list[BenchmarkCell], list[TrialMetrics]]:
    """Run every method under every condition, `trials_n` trials each.

    A cell depends only on seed, method, condition and number of trials: each random stream has its own name.
    """
    cells: list[BenchmarkCell] = []
    everything: list[TrialMetrics] = []
    for method in methods:
        for name, n in trials_n.items():
            under = condition(name)
            reason = under.why_not(method, inputs.config)
            if reason:
                cells.append(BenchmarkCell(method, name, n, None, reason))
                continue
            rows: list[TrialMetrics] = []
            config = under.config_under(inputs.config)
            task = make_task(config)
            trials = [task.trial(inputs.seed, purpose, i) for i in range(n)]
            for result, _ in run_trials(
                method, replace(inputs, config=config), trials, workers=workers, condition=name, watch=watch
            ):
                rows.append(result.metrics)
                if on_trial is not None:
                    on_trial(result)
            rng = stream(inputs.seed, f"bootstrap/{purpose}/{method}/{name}")
            # Without its push or move, a success is an undisturbed trial.
            missed = tuple(t.index for t in rows if under.act is not None and t.success and t.disturbed is not True)
            cells.append(BenchmarkCell(method, name, n, summarise(rows, rng), undisturbed=missed))
            everything += rows
    return cells, everything


def summaries(cells: Sequence[BenchmarkCell], name: str = CLEAN) -> list[MethodSummary]:
    """Return the summaries under one condition."""
    return [c.summary for c in cells if c.condition == name and c.summary is not None]


def write_cells(path: Path, cells: Sequence[BenchmarkCell]) -> Path:
    """Write a CSV row for each cell."""
    rows: list[dict[str, Any]] = []
    for cell in cells:
        applies = "yes" if cell.summary is not None else f"no: {cell.why_not}"
        values = {} if cell.summary is None else cell.summary.to_row()
        rows.append({"method": cell.method, "condition": cell.condition, "applies": applies, **values})
    return write_rows(path, rows, missing="does not apply")


def conditions_data(cells: Sequence[BenchmarkCell]) -> dict[str, Any]:
    """Return {condition: {summary, trials_n, methods}} without the clean cells."""
    table: dict[str, Any] = {}
    for cell in cells:
        if cell.condition != CLEAN:
            entry = {"summary": condition(cell.condition).summary, "trials_n": cell.asked_n, "methods": {}}
            table.setdefault(cell.condition, entry)["methods"][cell.method] = cell.record()
    return table
