"""Intervals and tests for small samples: 13 to 16 successes of 20 can be the same method."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

from minidual.errors import NothingEvaluatedError, UsageError

CONFIDENCE = 0.95
RESAMPLES_N = 5000


def wilson_interval(successes: int, n: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the Wilson score interval (low, high) of a success rate.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22 (1927). Unlike
    rate +- z sqrt(p q / n) it is not empty at 0 or n successes.

    Raises:
        NothingEvaluatedError: n is 0.
        UsageError: successes outside 0 to n, or confidence outside 0 to 1.
    """
    if n == 0:
        raise NothingEvaluatedError("no trials: a success rate of nothing has no interval")
    if not 0 <= successes <= n:
        raise UsageError(f"{successes} successes in {n} trials; there must be 0 to {n}")
    z = _z(confidence)
    rate = successes / n
    centre = rate + z * z / (2 * n)
    half = z * math.sqrt(rate * (1 - rate) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    # Exactly 0 or 1 at the ends, despite rounding.
    low = 0.0 if successes == 0 else (centre - half) / scale
    high = 1.0 if successes == n else (centre + half) / scale
    return low, high


def bootstrap_median_interval(
    values: ArrayLike, rng: np.random.Generator, confidence: float = CONFIDENCE, resamples_n: int = RESAMPLES_N
) -> tuple[float, float]:
    """Return the percentile bootstrap interval (low, high) of a median.

    Raises:
        NothingEvaluatedError: No values.
        UsageError: A value is not finite, or confidence outside 0 to 1.
    """
    sample = np.asarray(values, dtype=float).ravel()
    if sample.size == 0:
        raise NothingEvaluatedError("no values: a median of nothing has no interval")
    if not np.all(np.isfinite(sample)):
        raise UsageError("a median interval needs finite values; some are NaN or infinite")
    _z(confidence)
    medians = np.median(sample[rng.integers(0, sample.size, (resamples_n, sample.size))], axis=1)
    tail = (1 - confidence) / 2
    low, high = np.quantile(medians, [tail, 1 - tail])
    return float(low), float(high)


@dataclass(frozen=True)
class PairedComparison:
    """Two methods on the same seeds; `p_value` is McNemar's, exact, two-sided."""

    both_n: int
    only_first_n: int
    only_second_n: int
    neither_n: int
    p_value: float

    @property
    def trials_n(self) -> int:
        """Number of pairs."""
        return self.both_n + self.only_first_n + self.only_second_n + self.neither_n

    @property
    def rate_difference(self) -> float:
        """Success rate of the first minus that of the second."""
        return (self.only_first_n - self.only_second_n) / self.trials_n

    @property
    def rate_interval(self) -> tuple[float, float]:
        """95 % interval (low, high) of `rate_difference`."""
        return paired_rate_interval(self.both_n, self.only_first_n, self.only_second_n, self.neither_n)


def compare_paired(first: Sequence[bool], second: Sequence[bool]) -> PairedComparison:
    """Compare two methods on the same seeds with McNemar's exact test.

    Only discordant seeds carry evidence: for equal methods each is a fair coin. Source: Q. McNemar, Psychometrika 12
    (1947); exact binomial form.

    Raises:
        NothingEvaluatedError: No pairs.
        UsageError: The lengths differ.
    """
    if len(first) != len(second):
        raise UsageError(f"paired comparison of {len(first)} against {len(second)} trials; they must be as many")
    if not len(first):
        raise NothingEvaluatedError("no paired trials to compare")
    a, b = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    only_first, only_second = int(np.sum(a & ~b)), int(np.sum(~a & b))
    return PairedComparison(
        both_n=int(np.sum(a & b)),
        only_first_n=only_first,
        only_second_n=only_second,
        neither_n=int(np.sum(~a & ~b)),
        p_value=_mcnemar_exact(only_first, only_second),
    )


def paired_rate_interval(
    both: int, only_first: int, only_second: int, neither: int, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Return the interval (low, high) of the difference of two paired success rates.

    Source: R. G. Newcombe, "Improved confidence intervals for the difference between binomial proportions based on
    paired data", Statistics in Medicine 17 (1998), method 10. A bootstrap would be empty without discordant trials.

    Raises:
        NothingEvaluatedError: No trials.
        UsageError: confidence outside 0 to 1.
    """
    n = both + only_first + only_second + neither
    first_low, first_high = wilson_interval(both + only_first, n, confidence)
    second_low, second_high = wilson_interval(both + only_second, n, confidence)
    first, second = (both + only_first) / n, (both + only_second) / n
    phi = _correlation(both, only_first, only_second, neither)
    # Distances of the rates from their interval ends, on the side where the difference shrinks or grows.
    down = (first - first_low, second_high - second)
    up = (first_high - first, second - second_low)
    low, high = (math.sqrt(max(0.0, a * a - 2.0 * phi * a * b + b * b)) for a, b in (down, up))
    return first - second - low, first - second + high


def _correlation(both: int, only_first: int, only_second: int, neither: int) -> float:
    """Return the phi coefficient, continuity-corrected if positive; 0 if undefined."""
    margins = (both + only_first) * (only_second + neither) * (both + only_second) * (only_first + neither)
    if margins == 0:
        return 0.0
    covariance = both * neither - only_first * only_second
    if covariance > 0:
        covariance = max(covariance - (both + only_first + only_second + neither) / 2.0, 0.0)
    return covariance / math.sqrt(margins)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values adjusted for the family-wise error rate, for any dependence.

    Source: S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6
    (1979). `p_values` must hold all tests of the family.

    Raises:
        UsageError: A value outside 0 to 1.
    """
    if not all(0.0 <= p <= 1.0 for p in p_values):
        raise UsageError(f"{next(p for p in p_values if not 0.0 <= p <= 1.0)} is no probability")
    found = [0.0] * len(p_values)
    highest = 0.0
    for rank, i in enumerate(sorted(range(len(p_values)), key=lambda i: p_values[i])):
        highest = max(highest, min(1.0, (len(p_values) - rank) * p_values[i]))
        found[i] = highest
    return found


def _mcnemar_exact(only_first: int, only_second: int) -> float:
    n = only_first + only_second
    if n == 0:
        return 1.0
    tail = sum(math.comb(n, k) for k in range(min(only_first, only_second) + 1))
    return min(1.0, 2 * tail / 2**n)


def _z(confidence: float) -> float:
    if not 0.0 < confidence < 1.0:
        raise UsageError(f"confidence is {confidence}; it must lie between 0 and 1")
    return NormalDist().inv_cdf(0.5 + confidence / 2)
