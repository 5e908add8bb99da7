"""One method under every condition of the table: how much of its success does each one cost?"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from minidual.config.root import Config
from minidual.config.seeds import stream
from minidual.tasks.task import make_task
from minidual.trials.conditions import CLEAN, CONDITIONS, Condition
from minidual.trials.methods import MethodInputs, method_spec
from minidual.trials.metrics import MethodSummary, TrialMetrics, summarise
from minidual.trials.tables import write_csv, write_text
from minidual.trials.trials import TrialResult, Watch, run_trials

DROP_MAX = 0.15
"""A condition may cost less than this share of the clean success rate."""
_ROUNDING = 1e-9
_COLUMNS = (
    "condition",
    "successes",
    "interval",
    "drop",
    "least_squeeze_n",
    "largest_tilt_deg",
    "peak_torque_percent",
    "holds",
    "first_failure",
)
PURPOSE = "perturb"
"""Random stream of the starts; every condition has the same ones, and no other stage sees them."""


@dataclass(frozen=True)
class Robustness:
    """A method under one condition.

    Attributes:
        condition: Row of the table of conditions.
        summary: Its trials; None where it does not apply.
        drop: Success rate lost against the clean condition; negative if gained.
        example: What happened to the first trial that failed, or an empty string.
        rate_min: Success rate that the clean condition must reach itself; None for the others. Without it a method
            that never succeeds would lose nothing to any disturbance.
        why_not: Why it does not apply, or an empty string.
        undisturbed: Indices of successes in which its push or move never took place; with one it does not hold.
    """

    condition: Condition
    summary: MethodSummary | None
    drop: float
    example: str
    rate_min: float | None = None
    why_not: str = ""
    undisturbed: tuple[int, ...] = ()

    @property
    def holds(self) -> bool:
        """Whether the loss stays under the limit, and the clean rate reaches its own; a NaN does neither."""
        if self.summary is None or self.undisturbed:
            return False
        reached = self.rate_min is None or self.summary.success_rate >= self.rate_min
        return reached and self.drop < DROP_MAX - _ROUNDING

    @property
    def fails(self) -> bool:
        """Whether it does not hold, and not because it does not apply."""
        return not self.holds and (self.summary is not None or not self.why_not)

    def row(self) -> dict[str, Any]:
        """Return the line of the table."""
        s = self.summary
        if s is None:
            blank = dict.fromkeys(_COLUMNS, "-")
            return {**blank, "condition": self.condition.name, "holds": f"does not apply: {self.why_not}"}
        return {
            "condition": self.condition.name,
            "successes": f"{s.successes_n} of {s.trials_n}",
            "interval": f"{100 * s.success_low:.0f} to {100 * s.success_high:.0f} %",
            "drop": f"{100 * self.drop:+.0f} points",
            "least_squeeze_n": _number(s.internal_force_min_n, 1.0, 1),
            "largest_tilt_deg": _number(s.tilt_max_rad, float(np.degrees(1.0)), 2),
            "peak_torque_percent": _number(s.torque_ratio_max, 100.0, 0),
            "holds": "yes" if self.holds else "NO",
            "first_failure": self.example,
        }


def run_under(
    method: str,
    inputs: MethodInputs,
    condition: Condition,
    purpose: str,
    trials_n: int,
    *,
    workers: int,
    watch: Watch | None = None,
) -> Iterator[TrialResult]:
    """Run the first trials of a purpose under a condition: its starts are those of every other condition and method."""
    config = condition.config_under(inputs.config)
    task = make_task(config)
    trials = [task.trial(inputs.seed, purpose, i) for i in range(trials_n)]
    for result, _ in run_trials(
        method, replace(inputs, config=config), trials, workers=workers, condition=condition.name, watch=watch
    ):
        yield result


def why_not(method: str, condition: Condition, config: Config) -> str:
    """Return why a condition is not run for a method: it cannot touch it, or its trials would be the clean ones."""
    return condition.why_not(method, method_spec(method).senses) or condition.same_as_clean(config)


def undisturbed(condition: Condition, trials: Sequence[TrialMetrics]) -> tuple[int, ...]:
    """Return the indices of successes in which the push or move never took place: clean trials under another name."""
    return tuple(t.index for t in trials if condition.acts_once and t.success and t.disturbed is not True)


def touching(method: str) -> dict[str, Condition]:
    """Return the conditions that a carry must hold and that can touch a method, the clean one first."""
    senses = method_spec(method).senses
    return {name: c for name, c in CONDITIONS.items() if c.promised and not c.why_not(method, senses)}


def run_perturbations(
    method: str,
    inputs: MethodInputs,
    trials_n: int,
    *,
    workers: int,
    on_trial: Callable[[str, TrialResult], None] | None = None,
    watch: Watch | None = None,
) -> tuple[list[Robustness], list[TrialMetrics]]:
    """Run the same trials under every condition that touches the method; results do not depend on `workers`."""
    found: list[Robustness] = []
    everything: list[TrialMetrics] = []
    clean_rate = float("nan")
    for condition in touching(method).values():
        condition.config_under(inputs.config)  # one that is out of bounds is refused before minutes of trials
    for name, condition in touching(method).items():
        reason = why_not(method, condition, inputs.config)
        if reason:
            found.append(Robustness(condition, None, float("nan"), "", why_not=reason))
            continue
        results: list[TrialResult] = []
        for result in run_under(method, inputs, condition, PURPOSE, trials_n, workers=workers, watch=watch):
            results.append(result)
            if on_trial is not None:
                on_trial(name, result)
        metrics = [r.metrics for r in results]
        summary = summarise(metrics, stream(inputs.seed, f"bootstrap/{PURPOSE}/{name}"))
        if name == CLEAN:
            clean_rate = summary.success_rate
        example = next((f"trial {r.metrics.index}: {r.text}" for r in results if not r.success), "")
        rate_min = inputs.config.carry.limits.success_rate_min if name == CLEAN else None
        missed = undisturbed(condition, metrics)
        if missed:
            example = f"trial {missed[0]}: success, but its push or move never took place"
        found.append(
            Robustness(condition, summary, clean_rate - summary.success_rate, example, rate_min, undisturbed=missed)
        )
        everything += metrics
    return found, everything


def write_perturbations(folder: Path, found: Sequence[Robustness], trials: Sequence[TrialMetrics]) -> None:
    """Write conditions.csv (one row a condition) and trials.csv (one row a trial)."""
    rows = [r.row() for r in found]
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(folder / "conditions.csv", text.getvalue())
    write_csv(folder / "trials.csv", trials)


def table_lines(found: Sequence[Robustness]) -> list[str]:
    """Return the table as Markdown, to read and to paste."""
    rows = [r.row() for r in found]
    heads = [head.replace("_", " ") for head in rows[0]]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    return lines + ["| " + " | ".join(str(v) for v in row.values()) + " |" for row in rows]


def _number(value: float, factor: float, digits: int) -> str:
    return f"{factor * value:.{digits}f}" if np.isfinite(value) else "no successful trial"
