"""Paired comparisons on the same starts.

Success: McNemar's exact test and Newcombe's interval. Completion time: bootstrap of the median difference over starts
that both completed.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Sequence
from itertools import combinations

from minidual.config.seeds import stream
from minidual.errors import DataError
from minidual.trials.conditions import CLEAN
from minidual.trials.metrics import Cell, TrialMetrics
from minidual.trials.statistics import bootstrap_median_interval, compare_paired

NO_PAIR = "no start completed by both"

_Starts = dict[int, TrialMetrics]


def compare_all(trials: Sequence[TrialMetrics], seed: int = 0) -> list[dict[str, Cell]]:
    """Compare each pair of methods per condition; bootstraps have named streams, so order does not matter."""
    rows: list[dict[str, Cell]] = []
    for condition, methods in _grouped(trials, lambda t: t.condition, lambda t: t.method).items():
        for (first, one), (second, two) in combinations(methods.items(), 2):
            pair = _compared(one, two, seed, f"{condition}/{'/'.join(sorted((first, second)))}")
            if pair is not None:
                rows.append({"condition": condition, "first": first, "second": second, **pair})
    return rows


def compare_with_clean(trials: Sequence[TrialMetrics], seed: int = 0) -> list[dict[str, Cell]]:
    """Compare each method's disturbed trials with its clean ones; differences are disturbed minus clean."""
    rows: list[dict[str, Cell]] = []
    for method, conditions in _grouped(trials, lambda t: t.method, lambda t: t.condition).items():
        for condition, disturbed in conditions.items():
            if condition == CLEAN or CLEAN not in conditions:
                continue
            pair = _compared(disturbed, conditions[CLEAN], seed, f"{method}/{condition}/{CLEAN}")
            if pair is not None:
                rows.append({"method": method, "first": condition, "second": CLEAN, **pair})
    return rows


def _grouped(
    trials: Sequence[TrialMetrics], outer: Callable[[TrialMetrics], str], inner: Callable[[TrialMetrics], str]
) -> dict[str, dict[str, _Starts]]:
    groups: dict[str, dict[str, _Starts]] = {}
    for trial in trials:
        groups.setdefault(outer(trial), {}).setdefault(inner(trial), {})[trial.index] = trial
    return groups


def _compared(one: _Starts, two: _Starts, seed: int, name: str) -> dict[str, Cell] | None:
    """Return the row for the shared starts, or None."""
    shared = sorted(one.keys() & two.keys())
    if not shared:
        return None
    paired = compare_paired([one[i].success for i in shared], [two[i].success for i in shared])
    low, high = paired.rate_interval
    times = [one[i].duration_s - two[i].duration_s for i in shared if one[i].success and two[i].success]
    middle, least, most = _median_difference(times, seed, name)
    return {
        "trials_n": paired.trials_n,
        "both_n": paired.both_n,
        "only_first_n": paired.only_first_n,
        "only_second_n": paired.only_second_n,
        "neither_n": paired.neither_n,
        "rate_difference": paired.rate_difference,
        "rate_difference_low": low,
        "rate_difference_high": high,
        "p_value": paired.p_value,
        "duration_difference_s": middle,
        "duration_difference_low_s": least,
        "duration_difference_high_s": most,
    }


def _median_difference(times: Sequence[float], seed: int, name: str) -> tuple[Cell, Cell, Cell]:
    if not times:
        return NO_PAIR, NO_PAIR, NO_PAIR
    if not all(math.isfinite(t) for t in times):
        raise DataError(f"{name}: a trial that succeeded has no completion time, so the pair has no difference")
    low, high = bootstrap_median_interval(times, stream(seed, f"bootstrap/paired/{name}"))
    return statistics.median(times), low, high
