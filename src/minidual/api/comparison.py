"""Compare two series of trials of the same starts."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from minidual.api.trials import Trials
from minidual.errors import UsageError
from minidual.show.report.sentences import sentence
from minidual.show.report.words import Words
from minidual.trials.answers import answer
from minidual.trials.comparisons import compare_all
from minidual.trials.metrics import Cell, TrialMetrics


@dataclass(frozen=True)
class Comparison:
    """Two series of trials, start by start.

    Attributes:
        sentence: Which one is better and by how much, or how many trials would tell.
        first, second: Labels.
        trials_n: Starts that both tried.
        both_n, only_first_n, only_second_n, neither_n: Starts that both, one or none solved.
        rate_difference: Success rate of the first minus that of the second.
        rate_interval: 95 % interval (low, high) of that difference (Newcombe).
        p_value: McNemar's exact test of equal success.
        duration_difference_s: Median over starts that both solved, first minus second [s]; NaN
            without one.
        duration_interval_s: 95 % bootstrap interval (low, high) of that median [s].
    """

    sentence: str
    first: str
    second: str
    trials_n: int
    both_n: int
    only_first_n: int
    only_second_n: int
    neither_n: int
    rate_difference: float
    rate_interval: tuple[float, float]
    p_value: float
    duration_difference_s: float
    duration_interval_s: tuple[float, float]


def compare(first: Trials, second: Trials) -> Comparison:
    """Compare two methods, or one method under two settings or conditions.

    Raises:
        UsageError: Other tasks, seeds or starts, or the same label.
    """
    _check_pair(first, second)
    trials = [*_labelled(first), *_labelled(second)]
    (row,) = compare_all(trials, first.seed)
    return Comparison(
        sentence=sentence(answer(first.task, trials, first.seed), Words("en")),
        first=first.label,
        second=second.label,
        trials_n=int(row["trials_n"]),
        both_n=int(row["both_n"]),
        only_first_n=int(row["only_first_n"]),
        only_second_n=int(row["only_second_n"]),
        neither_n=int(row["neither_n"]),
        rate_difference=float(row["rate_difference"]),
        rate_interval=(float(row["rate_difference_low"]), float(row["rate_difference_high"])),
        p_value=float(row["p_value"]),
        duration_difference_s=_number(row, "duration_difference_s"),
        duration_interval_s=(
            _number(row, "duration_difference_low_s"),
            _number(row, "duration_difference_high_s"),
        ),
    )


def _check_pair(first: Trials, second: Trials) -> None:
    for name in ("task", "seed"):
        ours = getattr(first, name)
        theirs = getattr(second, name)
        if ours != theirs:
            raise UsageError(f"the trials differ in {name}: {ours} and {theirs}")
    starts = [[result.index for result in trials] for trials in (first, second)]
    if starts[0] != starts[1]:
        raise UsageError(
            f"the trials are of other starts: {starts[0][0]} to {starts[0][-1]} and"
            f" {starts[1][0]} to {starts[1][-1]}",
            remedy="run both with the same first= and trials=",
        )
    if first.label == second.label:
        raise UsageError(
            f"both series have the label '{first.label}'",
            remedy="name them: run_trials(..., label='soft')",
        )


def _labelled(trials: Trials) -> list[TrialMetrics]:
    """Return the results with the label as their method, as if under one condition."""
    return [replace(result, method=trials.label, condition="clean") for result in trials]


def _number(row: Mapping[str, Cell], name: str) -> float:
    """Return a number of a comparison; NaN for the words that say there is no pair."""
    value = row[name]
    return math.nan if isinstance(value, str) else float(value)
