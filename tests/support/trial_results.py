"""Results of trials, good and bad, for checks of stages."""

import math
from collections.abc import Sequence
from typing import Any

from minidual.gate.check import Check
from minidual.trials.metrics import TrialMetrics

GOOD: dict[str, Any] = {
    "method": "impedance",
    "index": 0,
    "condition": "clean",
    "success": True,
    "failure": "",
    "reason": "",
    "failed_at_s": math.nan,
    "duration_s": 7.9,
    "torque_ratio_max": 0.8,
    "jerk_rms": 22.0,
    "tilt_max_rad": 0.01,
    "path_length_m": 2.8,
    "internal_force_min_n": 39.0,
    "pinch_force_min_n": 60.0,
    "goal_error_m": 0.001,
}
BAD: dict[str, Any] = {
    "success": False,
    "failure": "held",
    "reason": "dropped",
    "failed_at_s": 3.0,
    "duration_s": math.nan,
}
"""Changes of a good trial in which the object is dropped."""


def result(index: int, **changes: Any) -> TrialMetrics:
    """Return a good trial with changes."""
    return TrialMetrics(**{**GOOD, "index": index, **changes})


def results(n: int = 10, **last: Any) -> list[TrialMetrics]:
    """Return n good trials, the last one changed."""
    return [*(result(i) for i in range(n - 1)), result(n - 1, **last)]


def missed(count: int, n: int = 10) -> list[TrialMetrics]:
    """Return n trials, of which the first `count` drop the object."""
    return [result(i, **(BAD if i < count else {})) for i in range(n)]


def failing(checks: Sequence[Check]) -> set[str]:
    """Return the names of the checks that fail."""
    return {check.name for check in checks if check.passed is False}
