"""Benchmark: every method under every condition, from the same starts, and paired comparisons.

Success: McNemar's exact test, Newcombe's interval. Completion time, over starts that both completed: bootstrap of the
median difference.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from minidual.config.root import Config
from minidual.config.seeds import stream
from minidual.errors import DataError
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Trial
from minidual.trials.conditions import CLEAN, CONDITIONS, condition, parse_conditions
from minidual.trials.methods import METHODS, MethodInputs
from minidual.trials.metrics import Cell, MethodSummary, TrialMetrics, summarise
from minidual.trials.runner import Watch, run_trials
from minidual.trials.statistics import (
    bootstrap_median_interval,
    mcnemar_p_value,
    paired_rate_interval,
)

PURPOSE = "benchmark"
"""Random stream of the starts, used by no earlier stage."""
PERTURBED = "perturb"
"""Random stream of the starts of `robustness`, used by no other stage."""
DISTURBED_RATE_MIN = 0.95
"""Least success rate of a carry under each promised condition."""
NO_PAIR = "no start completed by both"
FAILURES_MAX = 3
"""Failed trials of a task that are drawn."""
_Starts = dict[int, TrialMetrics]
type Draw = Callable[[int], Trial]


class BenchmarkCell(NamedTuple):
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
    trials_n = {
        name: asked.trials_n if name == CLEAN else asked.perturbed_trials_n for name in names
    }
    every = dict.fromkeys(asked.tasks or (config.task,), trials_n)
    further = {} if asked.tasks else asked.further_tasks
    return every | {
        task: {CLEAN: min(n, asked.trials_n)} for task, n in further.items() if task not in every
    }


def _why_not(method: str, name: str, inputs: MethodInputs) -> str:
    task = make_task(inputs.config)
    return METHODS[method].cannot(task, inputs.trained) or condition(name).why_not(
        method,
        inputs.config,
    )


def count_trials(methods: Sequence[str], trials_n: Mapping[str, int], inputs: MethodInputs) -> int:
    """Return how many trials `run_benchmark` runs."""
    return sum(n for m in methods for c, n in trials_n.items() if not _why_not(m, c, inputs))


def draw_under(inputs: MethodInputs, name: str, purpose: str = PURPOSE) -> Draw:
    """Return the draw of a condition's trials."""
    under = condition(name)
    task = make_task(under.config_under(inputs.config))
    return lambda index: task.trial(inputs.seed, purpose, index, widen=under.widen)


def first_failures(trials: Sequence[TrialMetrics]) -> list[TrialMetrics]:
    """Return the first failed trial of each method and kind of failure, `FAILURES_MAX` at most; clean ones first."""
    failed = sorted((t for t in trials if not t.success), key=lambda t: t.condition != CLEAN)
    return sorted({(t.method, t.failure): t for t in reversed(failed)}.values(), key=failed.index)[
        :FAILURES_MAX
    ]


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
    drawn = {name: draw_under(inputs, name, purpose) for name in trials_n}
    cells: list[BenchmarkCell] = []
    everything: list[TrialMetrics] = []
    for method in methods:
        for name, n in trials_n.items():
            under = condition(name)
            if reason := _why_not(method, name, inputs):
                cells.append(BenchmarkCell(method, name, n, None, reason))
                continue
            rows = list[TrialMetrics]()
            asked = [*map(drawn[name], range(n))]
            for result in run_trials(
                method,
                inputs,
                asked,
                workers=workers,
                condition=name,
                watch=watch,
            ):
                rows.append(result)
                on_trial(result)
            rng = stream(inputs.seed, f"bootstrap/{purpose}/{method}/{name}")
            # Without its push or move, a success is an undisturbed trial.
            missed = tuple(
                t.index
                for t in rows
                if under.act is not None and t.success and t.disturbed is not True
            )
            cells.append(BenchmarkCell(method, name, n, summarise(rows, rng), undisturbed=missed))
            everything += rows
    return cells, everything


def benchmark_data(
    cells: Sequence[BenchmarkCell],
    trials: Sequence[TrialMetrics],
    seed: int,
) -> dict[str, Any]:
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
            entry = {
                "summary": condition(cell.condition).summary,
                "trials_n": cell.asked_n,
                "methods": {},
            }
            table.setdefault(cell.condition, entry)["methods"][cell.method] = cell.record()
    return table


def compare_all(trials: Sequence[TrialMetrics], seed: int = 0) -> list[dict[str, Cell]]:
    """Compare each pair of methods per condition."""
    rows: list[dict[str, Cell]] = []
    methods = dict.fromkeys(t.method for t in trials)
    for under in dict.fromkeys(t.condition for t in trials):
        for first, second in combinations(methods, 2):
            name = f"{under}/{'/'.join(sorted((first, second)))}"
            one = _starts(trials, first, under)
            two = _starts(trials, second, under)
            rows += _compared(one, two, seed, name, condition=under, first=first, second=second)
    return rows


def compare_with_clean(trials: Sequence[TrialMetrics], seed: int = 0) -> list[dict[str, Cell]]:
    """Compare each method's disturbed trials with its clean ones; differences are disturbed minus clean."""
    rows: list[dict[str, Cell]] = []
    for method, under in dict.fromkeys(
        (t.method, t.condition) for t in trials if t.condition != CLEAN
    ):
        one = _starts(trials, method, under)
        two = _starts(trials, method, CLEAN)
        rows += _compared(
            one,
            two,
            seed,
            f"{method}/{under}/{CLEAN}",
            method=method,
            first=under,
            second=CLEAN,
        )
    return rows


def _starts(trials: Sequence[TrialMetrics], method: str, under: str) -> _Starts:
    return {t.index: t for t in trials if (t.method, t.condition) == (method, under)}


def _compared(
    one: _Starts,
    two: _Starts,
    seed: int,
    name: str,
    **labels: Cell,
) -> list[dict[str, Cell]]:
    if not (shared := sorted(one.keys() & two.keys())):
        return []
    won = [(one[i].success, two[i].success) for i in shared]
    both, first, second, neither = (won.count((a, b)) for a in (True, False) for b in (True, False))
    low, high = paired_rate_interval(both, first, second, neither)
    times = [
        one[i].duration_s - two[i].duration_s for i in shared if one[i].success and two[i].success
    ]
    if not np.isfinite(times).all():
        raise DataError(
            f"{name}: a trial that succeeded has no completion time, so the pair has no difference",
        )
    least, most = bootstrap_median_interval(times, stream(seed, f"bootstrap/paired/{name}"))
    row: dict[str, Cell] = {**labels, "trials_n": len(shared), "both_n": both}
    row |= {"only_first_n": first, "only_second_n": second, "neither_n": neither}
    row |= {"rate_difference": (first - second) / len(shared)}
    row |= {
        "rate_difference_low": low,
        "rate_difference_high": high,
        "p_value": mcnemar_p_value(first, second),
    }
    row |= {"duration_difference_s": float(np.median(times)) if times else math.nan}
    row |= {"duration_difference_low_s": least, "duration_difference_high_s": most}
    return [{k: NO_PAIR if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()}]


class Robustness(NamedTuple):
    """A method under one condition.

    Attributes:
        drop: Success rate lost against clean.
        rate_min: Least success rate.
    """

    cell: BenchmarkCell
    drop: float
    example: str
    rate_min: float = DISTURBED_RATE_MIN

    @property
    def holds(self) -> bool:
        """Whether the rate reaches its limit (false for NaN), or the condition does not apply."""
        if (s := self.cell.summary) is None:
            return bool(self.cell.why_not)
        return not self.cell.undisturbed and s["success_rate"] >= self.rate_min

    def row(self) -> dict[str, Any]:
        """Return the table row, only condition and reason where it does not apply."""
        s = self.cell.summary
        name = self.cell.condition
        if s is None:
            return {"condition": name, "holds": f"does not apply: {self.cell.why_not}"}
        return {
            "condition": name,
            "successes": f"{s.successes_n} of {s.trials_n}",
            "interval": f"{100 * s['success_low']:.0f} to {100 * s['success_high']:.0f} %",
            "drop": f"{100 * self.drop:+.0f} points",
            "least_squeeze_n": _number(s["internal_force_min_n"], 1),
            "largest_tilt_deg": _number(np.degrees(s["tilt_max_rad"]), 2),
            "peak_torque_percent": _number(100.0 * s["torque_ratio_max"], 0),
            "first_failure": self.example,
            "holds": "yes" if self.holds else "NO",
        }


def promised(trials_n: int) -> dict[str, int]:
    """Return {condition: trials} of the conditions that a carry must pass, clean first."""
    return {name: trials_n for name, row in CONDITIONS.items() if row.promised}


def limits_of(config: Config, task: str, method: str, name: str) -> str:
    """Return the limit that the product promises for a cell, as text; empty where it promises nothing."""
    if name == CLEAN:
        least = config.benchmark.success_rate_min.get(method)
        return "" if least is None else f"more than {100 * least:.0f} %"
    if method == "impedance" and task == "rod_carry" and CONDITIONS[name].promised:
        return f"{100 * DISTURBED_RATE_MIN:.0f} % or more (carry --perturb)"
    asked = config.deploy.condition_rate_min.get(name)
    return (
        f"{100 * asked:.0f} % or more (deploy)"
        if asked and method == "act" and task == config.task
        else ""
    )


def robustness(
    cells: Sequence[BenchmarkCell],
    trials: Sequence[TrialMetrics],
    rate_min: float,
) -> list[Robustness]:
    """Return what each condition costs a method; undisturbed, its rate must reach `rate_min`."""
    rates = {c.condition: c.summary["success_rate"] for c in cells if c.summary is not None}
    rows: list[Robustness] = []
    for cell in cells:
        failed = (
            f"trial {t.index}: {t.text}"
            for t in trials
            if t.condition == cell.condition and not t.success
        )
        example = next(failed, "")
        if cell.undisturbed:
            example = f"trial {cell.undisturbed[0]}: success, but its push or move never took place"
        drop = rates[CLEAN] - rates.get(cell.condition, float("nan"))
        rows.append(
            Robustness(
                cell,
                drop,
                example,
                rate_min if cell.condition == CLEAN else DISTURBED_RATE_MIN,
            ),
        )
    return rows


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "no successful trial"
