"""Paired comparisons on shared starts.

Success: McNemar's exact test, Newcombe's interval. Completion time, over starts that both completed: bootstrap of the
median difference.
"""

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from minidual.config.seeds import stream
from minidual.errors import DataError
from minidual.trials.conditions import CLEAN
from minidual.trials.metrics import Cell, TrialMetrics
from minidual.trials.statistics import bootstrap_median_interval, mcnemar_p_value, paired_rate_interval

NO_PAIR = "no start completed by both"

_Starts = dict[int, TrialMetrics]


def compare_all(trials: Sequence[TrialMetrics], seed: int = 0) -> list[dict[str, Cell]]:
    """Compare each pair of methods per condition."""
    rows: list[dict[str, Cell]] = []
    methods = dict.fromkeys(t.method for t in trials)
    for condition in dict.fromkeys(t.condition for t in trials):
        for first, second in combinations(methods, 2):
            name = f"{condition}/{'/'.join(sorted((first, second)))}"
            one, two = _starts(trials, first, condition), _starts(trials, second, condition)
            rows += _compared(one, two, seed, name, condition=condition, first=first, second=second)
    return rows


def compare_with_clean(trials: Sequence[TrialMetrics], seed: int = 0) -> list[dict[str, Cell]]:
    """Compare each method's disturbed trials with its clean ones; differences are disturbed minus clean."""
    rows: list[dict[str, Cell]] = []
    for method, condition in dict.fromkeys((t.method, t.condition) for t in trials if t.condition != CLEAN):
        one, two = _starts(trials, method, condition), _starts(trials, method, CLEAN)
        rows += _compared(one, two, seed, f"{method}/{condition}/{CLEAN}", method=method, first=condition, second=CLEAN)
    return rows


def _starts(trials: Sequence[TrialMetrics], method: str, condition: str) -> _Starts:
    return {t.index: t for t in trials if (t.method, t.condition) == (method, condition)}


def _compared(one: _Starts, two: _Starts, seed: int, name: str, **labels: Cell) -> list[dict[str, Cell]]:
    shared = sorted(one.keys() & two.keys())
    if not shared:
        return []
    won = [(one[i].success, two[i].success) for i in shared]
    both, first, second, neither = (won.count((a, b)) for a in (True, False) for b in (True, False))
    low, high = paired_rate_interval(both, first, second, neither)
    times = [one[i].duration_s - two[i].duration_s for i in shared if one[i].success and two[i].success]
    if not np.isfinite(times).all():
        raise DataError(f"{name}: a trial that succeeded has no completion time, so the pair has no difference")
    least, most = bootstrap_median_interval(times, stream(seed, f"bootstrap/paired/{name}"))
    row: dict[str, Cell] = {**labels, "trials_n": len(shared), "both_n": both}
    row |= {"only_first_n": first, "only_second_n": second, "neither_n": neither}
    row |= {"rate_difference": (first - second) / len(shared)}
    row |= {"rate_difference_low": low, "rate_difference_high": high, "p_value": mcnemar_p_value(first, second)}
    row |= {"duration_difference_s": float(np.median(times)) if times else math.nan}
    row |= {"duration_difference_low_s": least, "duration_difference_high_s": most}
    return [{k: NO_PAIR if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()}]
