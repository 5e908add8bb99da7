"""Comparison of two methods on paired trials: success rates, and differences of their motions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.stats import norm

from minidual.trials.comparisons import compare_all
from minidual.trials.contrasts import Contrast, contrast_all
from minidual.trials.metrics import TrialMetrics
from minidual.trials.statistics import holm

SIGNIFICANT = 0.05
"""Two-sided significance level."""
DIFFERENCE = 0.1
"""Difference of success rates that is worth finding, where the trials show none."""
HEADLINES_MAX = 5
_POWER = 0.8
_DISCORDANT_SHARE = 0.1
"""Share of starts that only one method solves, where the trials show none."""
_MOST_TRIALS = 10_000
_LEAST_SHARE = 0.03
"""Smaller differences of a quantity are not worth a word, however certain they are."""


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
    error = float(norm.ppf(1.0 - SIGNIFICANT / 2.0))
    power = float(norm.ppf(_POWER))
    spread = math.sqrt(max(0.0, discordant - difference**2))
    root = error * math.sqrt(discordant) + power * spread
    return min(_MOST_TRIALS, math.ceil((root / difference) ** 2))


@dataclass(frozen=True)
class Answer:
    """Two methods on the same starts of one task under one condition.

    Attributes:
        both_n, only_first_n, only_second_n: Starts by who succeeds.
        low, high: 95 % interval of the difference of success rates, first less second.
        p_value: McNemar's exact test, corrected for the other answers beside it.
        contrasts: Of the motions, with corrected p-values.
    """

    task: str
    condition: str
    first: str
    second: str
    trials_n: int
    both_n: int
    only_first_n: int
    only_second_n: int
    low: float
    high: float
    p_value: float
    contrasts: Sequence[Contrast] = field(default=())

    @property
    def successes(self) -> dict[str, int]:
        """Number of successes by method."""
        return {
            self.first: self.both_n + self.only_first_n,
            self.second: self.both_n + self.only_second_n,
        }

    @property
    def rate_difference(self) -> float:
        """First less second."""
        return (self.only_first_n - self.only_second_n) / self.trials_n

    @property
    def success_differs(self) -> bool:
        """Whether one method is shown to succeed more often."""
        return self.p_value < SIGNIFICANT

    @property
    def motions(self) -> list[Contrast]:
        """The shown differences of the motions in the order of QUANTITIES; one of the two forces."""
        significant = [
            contrast
            for contrast in self.contrasts
            if contrast.p_value < SIGNIFICANT
            and contrast.low * contrast.high > 0.0
            and contrast.share >= _LEAST_SHARE
        ]
        if any(contrast.quantity == "internal_force_min_n" for contrast in significant):
            significant = [
                contrast for contrast in significant if contrast.quantity != "pinch_force_min_n"
            ]
        return significant

    @property
    def tells(self) -> bool:
        """Whether it shows any difference."""
        return self.success_differs or bool(self.motions)

    @property
    def needed_at_these_rates(self) -> int | None:
        """Trials that would show this difference of success; None where there is none."""
        if self.only_first_n == self.only_second_n:
            return None
        return trials_needed(self.only_first_n / self.trials_n, self.only_second_n / self.trials_n)

    @property
    def needed_for_difference(self) -> int:
        """Trials that would show a difference of DIFFERENCE."""
        solved_by_one = (self.only_first_n + self.only_second_n) / self.trials_n
        share = max(_DISCORDANT_SHARE, solved_by_one)
        return trials_needed(0.5 * (share + DIFFERENCE), 0.5 * (share - DIFFERENCE))


def answers_of(
    task: str,
    comparisons: Iterable[Mapping[str, Any]],
    contrasts: Iterable[Mapping[str, Any]],
) -> list[Answer]:
    """Return the answers in the rows of `compare_all` and `contrast_all` of one task, uncorrected."""
    differences = [Contrast(**row) for row in contrasts]
    answers: list[Answer] = []
    for row in comparisons:
        pair = (row["condition"], row["first"], row["second"])
        own = [contrast for contrast in differences if _pair_of(contrast) == pair]
        answers.append(
            Answer(
                task=task,
                condition=row["condition"],
                first=row["first"],
                second=row["second"],
                trials_n=row["trials_n"],
                both_n=row["both_n"],
                only_first_n=row["only_first_n"],
                only_second_n=row["only_second_n"],
                low=row["rate_difference_low"],
                high=row["rate_difference_high"],
                p_value=row["p_value"],
                contrasts=tuple(own),
            ),
        )
    return answers


def _pair_of(contrast: Contrast) -> tuple[str, str, str]:
    return contrast.condition, contrast.first, contrast.second


def answer(task: str, trials: Sequence[TrialMetrics], seed: int = 0) -> Answer:
    """Return the answer of trials of exactly two methods under one condition.

    Args:
        task: Name of their task.
        trials: From the same starts.
        seed: Of the bootstrap.
    """
    rows = [contrast.to_row() for contrast in contrast_all(trials, seed)]
    (answer,) = answers_of(task, compare_all(trials, seed), rows)
    return corrected([answer])[0]


def corrected(answers: Sequence[Answer]) -> list[Answer]:
    """Return the answers with p-values after Holm's correction.

    The tests of success are one family, the tests of the motions another.
    """
    success = holm([one.p_value for one in answers])
    motion = holm([contrast.p_value for one in answers for contrast in one.contrasts])
    remaining = iter(motion)
    corrected_answers: list[Answer] = []
    for one, p_value in zip(answers, success, strict=True):
        contrasts = [replace(contrast, p_value=next(remaining)) for contrast in one.contrasts]
        corrected_answers.append(replace(one, p_value=p_value, contrasts=tuple(contrasts)))
    return corrected_answers


def headlines(tasks: Mapping[str, Mapping[str, Any]]) -> list[Answer]:
    """Return the answers in reading order: first those that show a difference.

    Each task is answered under the condition with most trials. Answers that show a difference of
    success come first, the largest difference before the others; then those of the motions, of tasks
    without an answer so far before others.

    Args:
        tasks: {task: its part of the benchmark's data}.
    """
    answers: list[Answer] = []
    for task, data in tasks.items():
        of_task = answers_of(task, data.get("comparisons", ()), data.get("contrasts", ()))
        if not of_task:
            continue
        most_n = max(one.trials_n for one in of_task)
        condition = next(one.condition for one in of_task if one.trials_n == most_n)
        answers += [one for one in of_task if one.condition == condition]
    return _one_of_each_task_first(sorted(corrected(answers), key=_rank))


def _one_of_each_task_first(ranked: Sequence[Answer]) -> list[Answer]:
    """Return the answers with the first of each task before the others, within their kinds."""
    on_success = [one for one in ranked if one.success_differs]
    on_motions = [one for one in ranked if one.tells and not one.success_differs]
    tasks = {one.task for one in on_success}
    first: list[Answer] = []
    further: list[Answer] = []
    for one in on_motions:
        (further if one.task in tasks else first).append(one)
        tasks.add(one.task)
    return [*on_success, *first, *further, *(one for one in ranked if not one.tells)]


def _rank(one: Answer) -> tuple[bool, bool, float]:
    largest = max((contrast.share for contrast in one.motions), default=0.0)
    size = abs(one.rate_difference) if one.success_differs else largest
    return not one.success_differs, not one.tells, -size


def medians(trials: Sequence[TrialMetrics], name: str) -> float:
    """Return the median of a number of successful trials; NaN without one."""
    values = [float(getattr(trial, name)) for trial in trials if trial.success]
    return float(np.median(values)) if values else math.nan
