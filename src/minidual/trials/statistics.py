"""Intervals and tests for small samples."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binomtest

from minidual.errors import NothingEvaluatedError, UsageError

_CONFIDENCE = 0.95
_RESAMPLES_N = 5000


def wilson_interval(successes: int, n: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval (low, high) of a success rate.

    It is not empty at 0 or n successes. Source: E. B. Wilson, JASA 22 (1927).

    Raises:
        NothingEvaluatedError: n is 0.
        UsageError: successes outside 0 to n.
    """
    if n == 0:
        raise NothingEvaluatedError("no trials: a success rate of nothing has no interval")
    if not 0 <= successes <= n:
        raise UsageError(f"{successes} successes in {n} trials; there must be 0 to {n}")
    low, high = binomtest(successes, n).proportion_ci(_CONFIDENCE, "wilson")
    return float(low), float(high)


def bootstrap_median_interval(values: ArrayLike, rng: np.random.Generator) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval (low, high) of a median.

    Both are NaN without values, or with NaN among them.
    """
    sample = np.asarray(values, dtype=float)
    if sample.size == 0 or not np.isfinite(sample).all():
        return math.nan, math.nan
    drawn = rng.integers(0, sample.size, (_RESAMPLES_N, sample.size))
    medians = np.median(sample[drawn], axis=1)
    low, high = np.quantile(medians, [(1 - _CONFIDENCE) / 2, (1 + _CONFIDENCE) / 2])
    return float(low), float(high)


def mcnemar_p_value(only_first: int, only_second: int) -> float:
    """Return the two-sided p-value of McNemar's exact test from the numbers of discordant pairs.

    Source: Q. McNemar, Psychometrika 12 (1947).
    """
    n = only_first + only_second
    return float(binomtest(only_first, n).pvalue) if n else 1.0


def paired_rate_interval(
    both: int,
    only_first: int,
    only_second: int,
    neither: int,
) -> tuple[float, float]:
    """Return the 95 % interval (low, high) of the difference of two paired success rates.

    Source: R. G. Newcombe, Statistics in Medicine 17 (1998) 2635, method 10.

    Raises:
        NothingEvaluatedError: No pairs.
    """
    n = both + only_first + only_second + neither
    first_low, first_high = wilson_interval(both + only_first, n)
    second_low, second_high = wilson_interval(both + only_second, n)
    first = (both + only_first) / n
    second = (both + only_second) / n
    phi = _corrected_phi(both, only_first, only_second, neither)
    # From each rate to the end of its interval on which the difference shrinks, or grows.
    shrinks = _combined(first - first_low, second_high - second, phi)
    grows = _combined(first_high - first, second - second_low, phi)
    return first - second - shrinks, first - second + grows


def _corrected_phi(both: int, only_first: int, only_second: int, neither: int) -> float:
    """Return the phi coefficient, continuity-corrected if positive; 0 if undefined."""
    n = both + only_first + only_second + neither
    margins = (
        (both + only_first)
        * (only_second + neither)
        * (both + only_second)
        * (only_first + neither)
    )
    if margins == 0:
        return 0.0
    covariance = both * neither - only_first * only_second
    if covariance > 0:
        covariance = max(covariance - n / 2.0, 0.0)
    return covariance / math.sqrt(margins)


def _combined(a: float, b: float, phi: float) -> float:
    """Return the half width of a difference whose parts have half widths a and b."""
    return math.sqrt(max(0.0, a * a - 2.0 * phi * a * b + b * b))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values adjusted for the family-wise error rate; `p_values` holds all tests of the family.

    Source: S. Holm, Scandinavian Journal of Statistics 6 (1979).

    Raises:
        UsageError: A value outside 0 to 1.
    """
    for p in p_values:
        if not 0.0 <= p <= 1.0:
            raise UsageError(f"{p} is no probability")
    order = np.argsort(p_values, kind="stable")
    scaled = np.asarray(p_values, dtype=float)[order] * np.arange(len(p_values), 0, -1)
    adjusted = np.empty(len(p_values))
    adjusted[order] = np.minimum(np.maximum.accumulate(scaled), 1.0)
    return adjusted.tolist()
