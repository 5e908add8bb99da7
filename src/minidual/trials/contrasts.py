"""Paired differences of time, torque, jerk and force, over the starts on which both methods succeed.

Each has the bootstrap interval of the median difference and the paired t-test. A rank test could not
tell a second from nothing in five trials, whatever its spread.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import t as student_t

from minidual.config.seeds import stream
from minidual.errors import DataError
from minidual.robot.pair import Array
from minidual.trials.metrics import Cell, TrialMetrics
from minidual.trials.statistics import bootstrap_median_interval

QUANTITIES = {
    "duration_s": False,
    "torque_ratio_max": False,
    "jerk_rms": False,
    "internal_force_min_n": True,
    "pinch_force_min_n": True,
}
"""Fields of TrialMetrics, and whether more of it is better."""
_LEAST_PAIRS = 3
_NO_SPREAD = 1e-12
"""Share of a mean below which a spread is rounding."""


@dataclass(frozen=True)
class Contrast:
    """One quantity of two methods under one condition, SI.

    Attributes:
        quantity: Key of QUANTITIES.
        pairs_n: Starts on which both succeed.
        first_median, second_median: Over these starts.
        difference: Median of first minus second.
        low, high: Its 95 % bootstrap interval.
        p_value: Two-sided, paired t-test.
    """

    condition: str
    first: str
    second: str
    quantity: str
    pairs_n: int
    first_median: float
    second_median: float
    difference: float
    low: float
    high: float
    p_value: float

    def to_row(self) -> dict[str, Cell]:
        """Return it for a verdict."""
        return dict(vars(self))

    @property
    def better(self) -> str:
        """The method that the difference favours."""
        more_is_better = QUANTITIES[self.quantity]
        first_is_better = (self.difference > 0.0) == more_is_better
        return self.first if first_is_better else self.second

    @property
    def share(self) -> float:
        """|Difference| / the larger median; 0 where that is 0."""
        largest = max(abs(self.first_median), abs(self.second_median))
        return abs(self.difference) / largest if largest > 0.0 else 0.0


def contrast_all(trials: Sequence[TrialMetrics], seed: int = 0) -> list[Contrast]:
    """Return the contrasts of each pair of methods per condition.

    A quantity that one of them lacks, or with fewer than three pairs, has none.

    Raises:
        DataError: A successful trial has no completion time.
    """
    contrasts: list[Contrast] = []
    methods = tuple(dict.fromkeys(trial.method for trial in trials))
    for condition in dict.fromkeys(trial.condition for trial in trials):
        for first, second in combinations(methods, 2):
            pairs = _pairs(trials, condition, first, second)
            for quantity in QUANTITIES:
                contrast = _contrast(condition, first, second, quantity, pairs, seed)
                if contrast is not None:
                    contrasts.append(contrast)
    return contrasts


type _Pairs = Sequence[tuple[TrialMetrics, TrialMetrics]]


def _pairs(trials: Sequence[TrialMetrics], condition: str, first: str, second: str) -> _Pairs:
    """Return the trials of both methods from the starts on which both succeed."""
    successes = [trial for trial in trials if trial.condition == condition and trial.success]
    of_first = {trial.index: trial for trial in successes if trial.method == first}
    of_second = {trial.index: trial for trial in successes if trial.method == second}
    return [(of_first[start], of_second[start]) for start in sorted(of_first) if start in of_second]


def _contrast(
    condition: str,
    first: str,
    second: str,
    quantity: str,
    pairs: _Pairs,
    seed: int,
) -> Contrast | None:
    values = np.array(
        [[getattr(trial, quantity) for trial in pair] for pair in pairs],
        dtype=float,
    )
    if len(values) < _LEAST_PAIRS:
        return None
    if not np.isfinite(values).all():
        if quantity == "duration_s":
            raise DataError(
                f"{first} or {second} under {condition}: a trial that succeeded has no completion time",
            )
        return None
    differences = values[:, 0] - values[:, 1]
    name = f"{condition}/{'/'.join(sorted((first, second)))}/{quantity}"
    low, high = bootstrap_median_interval(differences, stream(seed, f"bootstrap/contrast/{name}"))
    return Contrast(
        condition=condition,
        first=first,
        second=second,
        quantity=quantity,
        pairs_n=len(differences),
        first_median=float(np.median(values[:, 0])),
        second_median=float(np.median(values[:, 1])),
        difference=float(np.median(differences)),
        low=low,
        high=high,
        p_value=paired_t_p_value(differences),
    )


def paired_t_p_value(differences: Array) -> float:
    """Return the two-sided p-value of Student's paired t-test; of equal differences 1 or 0.

    Source: Student, Biometrika 6 (1908) 1.
    """
    n = len(differences)
    mean = float(np.mean(differences))
    error = float(np.std(differences, ddof=1)) / math.sqrt(n)
    if error <= _NO_SPREAD * abs(mean) or error == 0.0:
        return 1.0 if mean == 0.0 else 0.0
    return float(2.0 * student_t.sf(abs(mean) / error, n - 1))
