"""One sentence says which of two methods is better, or that the trials cannot tell."""

from __future__ import annotations

import math

import numpy as np
import pytest

from minidual.trials.answers import answer, medians, trials_needed
from minidual.trials.metrics import TrialMetrics
from minidual.trials.statistics import mcnemar_p_value
from tests.support.trial_results import BAD, result


def trial(method: str, index: int, duration_s: float | None) -> TrialMetrics:
    """Return a trial; it failed if it has no duration."""
    if duration_s is None:
        return result(index, method=method, **BAD)
    return result(index, method=method, duration_s=duration_s)


def series(method: str, durations_s: list[float | None]) -> list[TrialMetrics]:
    return [trial(method, index, duration_s) for index, duration_s in enumerate(durations_s)]


def test_the_method_that_succeeds_more_often_is_better() -> None:
    often = series("impedance", [6.0] * 20)
    seldom = series("moveit", [5.0] * 10 + [None] * 10)
    sentence = answer([*often, *seldom])
    assert sentence.startswith("impedance succeeds more often than moveit: 20 against 10 of 20")
    assert "p = 0.002" in sentence


def test_where_both_succeed_alike_the_faster_one_is_better() -> None:
    fast = series("moveit", [5.0, 5.1, 4.9, 5.0])
    slow = series("impedance", [6.0, 6.2, 5.9, 6.1])
    for trials in ([*fast, *slow], [*slow, *fast]):
        sentence = answer(trials)
        assert sentence.startswith("moveit is 1.05 s faster than impedance (95 % interval 1.0")
        assert "success does not differ in 4 starts (4 and 4)" in sentence


def test_equal_methods_cannot_be_told_apart_and_it_says_how_many_trials_would() -> None:
    durations_s: list[float | None] = [5.0, 5.2, 4.8, 5.1]
    backwards = durations_s[::-1]
    sentence = answer([*series("moveit", durations_s), *series("impedance", backwards)])
    assert sentence.startswith("Cannot tell moveit and impedance apart")
    assert (
        f"about {trials_needed(0.1, 0.0)} trials would find a difference of 10 points" in sentence
    )


def test_a_difference_that_chance_explains_is_no_difference() -> None:
    sentence = answer([*series("a", [5.0] * 5), *series("b", [5.0] * 4 + [None])])
    assert sentence.startswith("Cannot tell a and b apart")
    assert f"about {trials_needed(0.2, 0.0)} trials would, at these rates" in sentence


def test_a_single_pair_of_times_has_no_interval() -> None:
    assert answer([trial("a", 0, 5.0), trial("b", 0, 7.0)]).startswith("Cannot tell")


@pytest.mark.parametrize(("only_first", "only_second"), [(0.25, 0.05), (0.3, 0.1)])
def test_that_many_trials_find_the_difference_in_4_of_5_experiments(
    only_first: float,
    only_second: float,
) -> None:
    rng = np.random.default_rng(0)
    trials_n = trials_needed(only_first, only_second)
    shares = (only_first, only_second, 1.0 - only_first - only_second)
    experiments = rng.multinomial(trials_n, shares, size=500)
    found = [mcnemar_p_value(int(first), int(second)) < 0.05 for first, second, _ in experiments]
    assert 0.7 < np.mean(found) < 0.9


def test_no_number_of_trials_tells_equal_rates_apart() -> None:
    assert trials_needed(0.1, 0.1) == 10_000


def test_medians_are_over_successes() -> None:
    trials = series("a", [5.0, None, 7.0])
    assert medians(trials, "duration_s") == 6.0
    assert math.isnan(medians(series("a", [None]), "duration_s"))
