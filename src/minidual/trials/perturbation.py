"""Success lost by one method under each promised condition."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from minidual.trials.benchmark import BenchmarkCell
from minidual.trials.conditions import CLEAN, CONDITIONS
from minidual.trials.metrics import TrialMetrics

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
        rate_min: Least success rate: a method that always fails loses nothing.
    """

    cell: BenchmarkCell
    drop: float
    example: str
    rate_min: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether drop and rate are within their limits (false for NaN), or the condition does not apply."""
        s = self.cell.summary
        if s is None:
            return bool(self.cell.why_not)
        return not self.cell.undisturbed and s["success_rate"] >= self.rate_min and self.drop < DROP_MAX - _ROUNDING

    def row(self) -> dict[str, Any]:
        """Return the table row, only condition and reason where it does not apply."""
        s, name = self.cell.summary, self.cell.condition
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


def robustness(cells: Sequence[BenchmarkCell], trials: Sequence[TrialMetrics], rate_min: float) -> list[Robustness]:
    """Return what each condition costs one method, whose undisturbed rate must reach `rate_min`."""
    rates = {c.condition: c.summary["success_rate"] for c in cells if c.summary is not None}
    rows: list[Robustness] = []
    for cell in cells:
        failed = (f"trial {t.index}: {t.text}" for t in trials if t.condition == cell.condition and not t.success)
        example = next(failed, "")
        if cell.undisturbed:
            example = f"trial {cell.undisturbed[0]}: success, but its push or move never took place"
        drop = rates[CLEAN] - rates.get(cell.condition, float("nan"))
        rows.append(Robustness(cell, drop, example, rate_min if cell.condition == CLEAN else 0.0))
    return rows


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "no successful trial"
