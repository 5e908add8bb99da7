"""Loss of success of a method under each condition, and the least success rate."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from minidual.trials.benchmark import DISTURBED_RATE_MIN, BenchmarkCell
from minidual.trials.conditions import CLEAN
from minidual.trials.metrics import TrialMetrics


class Robustness(NamedTuple):
    """A method under one condition.

    Attributes:
        drop: Success rate lost against clean.
        example: The first failure as text, "" without one.
        rate_min: Least success rate.
    """

    cell: BenchmarkCell
    drop: float
    example: str
    rate_min: float = DISTURBED_RATE_MIN

    @property
    def holds(self) -> bool:
        """Whether the rate reaches its limit (false for NaN), or the condition does not apply."""
        summary = self.cell.summary
        if summary is None:
            return bool(self.cell.why_not)
        return not self.cell.undisturbed and summary["success_rate"] >= self.rate_min

    def row(self) -> dict[str, Any]:
        """Return the table row, only condition and reason where it does not apply."""
        summary = self.cell.summary
        name = self.cell.condition
        if summary is None:
            return {"condition": name, "holds": f"does not apply: {self.cell.why_not}"}
        low_percent = 100 * summary["success_low"]
        high_percent = 100 * summary["success_high"]
        tilt_deg = np.degrees(summary["tilt_max_rad"])
        return {
            "condition": name,
            "successes": f"{summary.successes_n} of {summary.trials_n}",
            "interval": f"{low_percent:.0f} to {high_percent:.0f} %",
            "drop": f"{100 * self.drop:+.0f} points",
            "least_squeeze_n": _number(summary["internal_force_min_n"], 1),
            "largest_tilt_deg": _number(tilt_deg, 2),
            "peak_torque_percent": _number(100.0 * summary["torque_ratio_max"], 0),
            "first_failure": self.example,
            "holds": "yes" if self.holds else "NO",
        }


def robustness(
    cells: Sequence[BenchmarkCell],
    trials: Sequence[TrialMetrics],
    rate_min: float,
) -> list[Robustness]:
    """Return the loss of a method under each condition; undisturbed, its rate must reach `rate_min`."""
    rates = {
        cell.condition: cell.summary["success_rate"] for cell in cells if cell.summary is not None
    }
    rows: list[Robustness] = []
    for cell in cells:
        drop = rates[CLEAN] - rates.get(cell.condition, float("nan"))
        limit = rate_min if cell.condition == CLEAN else DISTURBED_RATE_MIN
        rows.append(Robustness(cell, drop, _example(cell, trials), limit))
    return rows


def _example(cell: BenchmarkCell, trials: Sequence[TrialMetrics]) -> str:
    """Return the first trial of a cell that failed or was not disturbed, as text."""
    if cell.undisturbed:
        return f"trial {cell.undisturbed[0]}: success, but its push or move never took place"
    for trial in trials:
        if trial.condition == cell.condition and not trial.success:
            return f"trial {trial.index}: {trial.text}"
    return ""


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "no successful trial"
