"""Paired comparisons of trials from the same starts.

Success: McNemar's exact test, Newcombe's interval. Completion time, over starts that both
completed: bootstrap of the median difference.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from minidual.config.seeds import stream
from minidual.errors import DataError
from minidual.trials.conditions import CLEAN
from minidual.trials.metrics import Cell, TrialMetrics
from minidual.trials.statistics import (
    bootstrap_median_interval,
    mcnemar_p_value,
    paired_rate_interval,
)

NO_PAIR = "no start completed by both"

type _Series = Mapping[int, TrialMetrics]
"""Trials of one method under one condition, by start."""


def compare_all(trials: Sequence[TrialMetrics], seed: int = 0) -> list[dict[str, Cell]]:
    """Compare each pair of methods per condition."""
    rows: list[dict[str, Cell]] = []
    methods = dict.fromkeys(trial.method for trial in trials)
    for condition in dict.fromkeys(trial.condition for trial in trials):
        for first, second in combinations(methods, 2):
            name = f"{condition}/{'/'.join(sorted((first, second)))}"
            comparison = _compared(
                _series(trials, first, condition),
                _series(trials, second, condition),
                seed,
                name,
            )
            if comparison is not None:
                labels = {"condition": condition, "first": first, "second": second}
                rows.append({**labels, **comparison})
    return rows


def compare_with_clean(trials: Sequence[TrialMetrics], seed: int = 0) -> list[dict[str, Cell]]:
    """Compare each method's disturbed trials with its clean ones.

    Differences are disturbed minus clean.
    """
    rows: list[dict[str, Cell]] = []
    disturbed = ((trial.method, trial.condition) for trial in trials if trial.condition != CLEAN)
    for method, condition in dict.fromkeys(disturbed):
        comparison = _compared(
            _series(trials, method, condition),
            _series(trials, method, CLEAN),
            seed,
            f"{method}/{condition}/{CLEAN}",
        )
        if comparison is not None:
            labels = {"method": method, "first": condition, "second": CLEAN}
            rows.append({**labels, **comparison})
    return rows


def _series(trials: Sequence[TrialMetrics], method: str, condition: str) -> _Series:
    return {
        trial.index: trial
        for trial in trials
        if trial.method == method and trial.condition == condition
    }


def _compared(first: _Series, second: _Series, seed: int, name: str) -> dict[str, Cell] | None:
    """Compare two series on the starts that they share; None without one.

    Raises:
        DataError: A successful trial has no completion time.
    """
    shared = sorted(first.keys() & second.keys())
    if not shared:
        return None
    won = [(first[start].success, second[start].success) for start in shared]
    both_n = won.count((True, True))
    only_first_n = won.count((True, False))
    only_second_n = won.count((False, True))
    neither_n = won.count((False, False))
    rate_low, rate_high = paired_rate_interval(both_n, only_first_n, only_second_n, neither_n)
    differences_s = [
        first[start].duration_s - second[start].duration_s
        for start, outcomes in zip(shared, won, strict=True)
        if all(outcomes)
    ]
    if not np.isfinite(differences_s).all():
        raise DataError(
            f"{name}: a trial that succeeded has no completion time, so the pair has no difference",
        )
    rng = stream(seed, f"bootstrap/paired/{name}")
    duration_low_s, duration_high_s = bootstrap_median_interval(differences_s, rng)
    duration_s = float(np.median(differences_s)) if differences_s else math.nan
    return {
        "trials_n": len(shared),
        "both_n": both_n,
        "only_first_n": only_first_n,
        "only_second_n": only_second_n,
        "neither_n": neither_n,
        "rate_difference": (only_first_n - only_second_n) / len(shared),
        "rate_difference_low": rate_low,
        "rate_difference_high": rate_high,
        "p_value": mcnemar_p_value(only_first_n, only_second_n),
        "duration_difference_s": _or_no_pair(duration_s),
        "duration_difference_low_s": _or_no_pair(duration_low_s),
        "duration_difference_high_s": _or_no_pair(duration_high_s),
    }


def _or_no_pair(duration_s: float) -> Cell:
    return NO_PAIR if math.isnan(duration_s) else duration_s
