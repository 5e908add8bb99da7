"""Success lost by one method under each promised condition."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from minidual.trials.benchmark import BenchmarkCell, run_benchmark
from minidual.trials.conditions import CLEAN, CONDITIONS, Condition
from minidual.trials.methods import MethodInputs, method_spec
from minidual.trials.metrics import TrialMetrics
from minidual.trials.runner import TrialResult, Watch

DROP_MAX = 0.15
"""Limit of the loss of success rate."""
PURPOSE = "perturb"
"""Random stream of the starts, used by no other stage."""
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Robustness:
    """A method under one condition.

    Attributes:
        drop: Success rate lost against clean.
        example: First failed trial.
        rate_min: Required clean success rate; a method that always fails loses nothing.
    """

    cell: BenchmarkCell
    drop: float
    example: str
    rate_min: float | None = None

    @property
    def name(self) -> str:
        """Name of the condition."""
        return self.cell.condition

    @property
    def holds(self) -> bool:
        """Whether drop and clean rate meet their limits; false for NaN."""
        if self.cell.summary is None or self.cell.undisturbed:
            return False
        reached = self.rate_min is None or self.cell.summary.success_rate >= self.rate_min
        return reached and self.drop < DROP_MAX - _ROUNDING

    @property
    def fails(self) -> bool:
        """Whether it applies and does not hold."""
        return not self.holds and (self.cell.summary is not None or not self.cell.why_not)

    def row(self) -> dict[str, Any]:
        """Return the table row."""
        s = self.cell.summary
        values = (
            ["-"] * 6
            if s is None
            else [
                f"{s.successes_n} of {s.trials_n}",
                f"{100 * s.success_low:.0f} to {100 * s.success_high:.0f} %",
                f"{100 * self.drop:+.0f} points",
                _number(s.internal_force_min_n, 1.0, 1),
                _number(s.tilt_max_rad, float(np.degrees(1.0)), 2),
                _number(s.torque_ratio_max, 100.0, 0),
            ]
        )
        names = ("successes", "interval", "drop", "least_squeeze_n", "largest_tilt_deg", "peak_torque_percent")
        verdict = f"does not apply: {self.cell.why_not}" if s is None else "yes" if self.holds else "NO"
        ends = {"holds": verdict, "first_failure": "-" if s is None else self.example}
        return {"condition": self.name, **dict(zip(names, values, strict=True)), **ends}


def touching(method: str) -> dict[str, Condition]:
    """Return the promised conditions of a method, clean first."""
    senses = method_spec(method).senses
    return {name: c for name, c in CONDITIONS.items() if c.promised and (not c.sense or c.sense in senses)}


def run_perturbations(
    method: str,
    inputs: MethodInputs,
    trials_n: int,
    *,
    workers: int,
    on_trial: Callable[[TrialResult], None] | None = None,
    watch: Watch | None = None,
) -> tuple[list[Robustness], list[TrialMetrics]]:
    """Run the same trials under every condition that applies."""
    asked = touching(method)
    for condition in asked.values():
        condition.config_under(inputs.config)  # raise for values out of bounds before minutes of trials
    cells, trials = run_benchmark(
        [method],
        dict.fromkeys(asked, trials_n),
        inputs,
        workers=workers,
        purpose=PURPOSE,
        on_trial=on_trial,
        watch=watch,
    )
    rates = {c.condition: c.summary.success_rate for c in cells if c.summary is not None}
    rate_min = inputs.config.carry.limits.success_rate_min
    return [
        Robustness(
            cell,
            rates[CLEAN] - rates.get(cell.condition, float("nan")),
            _example(cell, trials),
            rate_min if cell.condition == CLEAN else None,
        )
        for cell in cells
    ], trials


def _example(cell: BenchmarkCell, trials: Sequence[TrialMetrics]) -> str:
    if cell.undisturbed:
        return f"trial {cell.undisturbed[0]}: success, but its push or move never took place"
    failed = (t for t in trials if t.condition == cell.condition and not t.success)
    return next((f"trial {t.index}: {t.text}" for t in failed), "")


def _number(value: float, factor: float, digits: int) -> str:
    return f"{factor * value:.{digits}f}" if np.isfinite(value) else "no successful trial"
