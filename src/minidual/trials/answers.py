"""One sentence on which of two methods is better, from trials of the same starts."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import norm

from minidual.trials.comparisons import compare_all
from minidual.trials.metrics import TrialMetrics

_SIGNIFICANT = 0.05
_POWER = 0.8
_DISCORDANT_SHARE = 0.1
"""Share of starts that only one method solves, where the trials show none."""
_DIFFERENCE = 0.1
"""Difference of success rates that is worth finding, where the trials show none."""
_MOST_TRIALS = 10_000


def trials_needed(only_first: float, only_second: float) -> int:
    """Return the number of starts at which McNemar's test finds a difference in 4 of 5 experiments.

    Args:
        only_first, only_second: Shares of the starts that only one of the methods solves.

    Source: R. J. Connor, Biometrics 43 (1987) 207.
    """
    difference = abs(only_first - only_second)
    if difference == 0.0:
        return _MOST_TRIALS
    discordant = only_first + only_second
    error = float(norm.ppf(1.0 - _SIGNIFICANT / 2.0))
    power = float(norm.ppf(_POWER))
    spread = math.sqrt(max(0.0, discordant - difference**2))
    root = error * math.sqrt(discordant) + power * spread
    return min(_MOST_TRIALS, math.ceil((root / difference) ** 2))


def answer(trials: Sequence[TrialMetrics], seed: int = 0) -> str:
    """Return which of two methods succeeds more often, else which is faster, else that none is known.

    Args:
        trials: Of exactly two methods under one condition, from the same starts.
        seed: Of the bootstrap.
    """
    (row,) = compare_all(trials, seed)
    first = str(row["first"])
    second = str(row["second"])
    trials_n = int(row["trials_n"])
    both_n = int(row["both_n"])
    wins = {
        first: both_n + int(row["only_first_n"]),
        second: both_n + int(row["only_second_n"]),
    }
    if float(row["p_value"]) < _SIGNIFICANT:
        better, worse = sorted(wins, key=lambda name: -wins[name])
        low = min(abs(float(row["rate_difference_low"])), abs(float(row["rate_difference_high"])))
        return (
            f"{better} succeeds more often than {worse}: {wins[better]} against {wins[worse]}"
            f" of {trials_n} starts, by {100 * low:.0f} points or more"
            f" (p = {float(row['p_value']):.2g})."
        )
    equal = f"success does not differ in {trials_n} starts ({wins[first]} and {wins[second]})"
    faster = _faster(row, first, second)
    if faster:
        return f"{faster}; {equal}."
    return (
        f"Cannot tell {first} and {second} apart: {equal}, and neither is faster;"
        f" {_how_many(row, trials_n)}."
    )


def _faster(row: dict[str, float | int | str | bool], first: str, second: str) -> str:
    """Return which method is faster where both succeed, or ""."""
    differences_s = [row[f"duration_difference_{end}s"] for end in ("low_", "high_", "")]
    if any(isinstance(difference_s, str) for difference_s in differences_s):
        return ""
    low_s, high_s, median_s = (float(difference_s) for difference_s in differences_s)
    pairs_n = int(row["both_n"])
    if pairs_n < 2 or not low_s * high_s > 0.0:
        return ""
    better, worse = (second, first) if median_s > 0.0 else (first, second)
    least_s, most_s = sorted((abs(low_s), abs(high_s)))
    interval = f"95 % interval {least_s:.2f} to {most_s:.2f} s"
    return f"{better} is {abs(median_s):.2f} s faster than {worse} ({interval}) where both succeed"


def _how_many(row: dict[str, float | int | str | bool], trials_n: int) -> str:
    only_first = int(row["only_first_n"]) / trials_n
    only_second = int(row["only_second_n"]) / trials_n
    if only_first != only_second:
        return f"about {trials_needed(only_first, only_second)} trials would, at these rates"
    share = max(_DISCORDANT_SHARE, only_first + only_second)
    needed = trials_needed(
        0.5 * (share + _DIFFERENCE),
        0.5 * (share - _DIFFERENCE),
    )
    return f"about {needed} trials would find a difference of {100 * _DIFFERENCE:.0f} points"


def medians(trials: Sequence[TrialMetrics], name: str) -> float:
    """Return the median of a number of successful trials; NaN without one."""
    values = [float(getattr(trial, name)) for trial in trials if trial.success]
    return float(np.median(values)) if values else math.nan
