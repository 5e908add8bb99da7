"""One sentence says which of two methods is better, or that the trials cannot tell."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from minidual.show.report.sentences import headline_sentences, sentence
from minidual.show.report.words import Words
from minidual.trials.answers import answer, corrected, headlines, medians, trials_needed
from minidual.trials.comparisons import compare_all
from minidual.trials.contrasts import contrast_all
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


def said(trials: list[TrialMetrics]) -> str:
    return sentence(answer("rod_carry", trials), Words("en"))


def test_the_method_that_succeeds_more_often_is_better() -> None:
    often = series("impedance", [6.0] * 20)
    seldom = series("moveit", [5.0] * 10 + [None] * 10)
    assert said([*often, *seldom]).startswith(
        "On rod_carry, impedance succeeds more often than moveit: 20 against 10 of 20 starts, "
        "50 points more (24 to 70; McNemar p = 0.002)",
    )


def test_where_both_succeed_alike_the_faster_one_is_named() -> None:
    fast = series("moveit", [5.0, 5.1, 4.9, 5.0])
    slow = series("impedance", [6.0, 6.2, 5.9, 6.1])
    for trials in ([*fast, *slow], [*slow, *fast]):
        text = said(trials)
        assert text.startswith("On rod_carry, moveit is 1.05 s faster (1.0")
        assert "paired t-test: p < 0.001" in text
        assert "no difference of success in 4 starts (4 and 4, McNemar p = 1;" in text


def test_equal_methods_cannot_be_told_apart_and_it_says_how_many_trials_would() -> None:
    durations_s: list[float | None] = [5.0, 5.2, 4.8, 5.1]
    backwards = durations_s[::-1]
    text = said([*series("moveit", durations_s), *series("impedance", backwards)])
    assert text.startswith("Cannot tell moveit and impedance apart on rod_carry: 4 and 4 of 4")
    assert f"about {trials_needed(0.1, 0.0)} trials would show 10 points" in text


def test_a_difference_that_chance_explains_is_no_difference() -> None:
    text = said([*series("a", [5.0] * 5), *series("b", [5.0] * 4 + [None])])
    assert text.startswith("Cannot tell a and b apart")
    assert f"about {trials_needed(0.2, 0.0)} trials would tell at these rates" in text


def test_a_certain_difference_that_nobody_would_notice_is_not_told() -> None:
    slower = [value + 0.02 for value in (5.0, 5.1, 4.9, 5.0)]
    made = answer("rod_carry", [*series("a", [5.0, 5.1, 4.9, 5.0]), *series("b", slower)])
    (duration,) = [c for c in made.contrasts if c.quantity == "duration_s"]
    assert duration.p_value < 0.05
    assert made.motions == []
    assert not made.tells


def test_a_single_pair_of_times_has_no_interval() -> None:
    assert said([trial("a", 0, 5.0), trial("b", 0, 7.0)]).startswith("Cannot tell")


def compared(task: str, gap_s: float, lost: int = 0, n: int = 20) -> dict[str, object]:
    """Return a task's data: `b` is slower by `gap_s`, and loses `lost` trials."""
    rng = np.random.default_rng(len(task))
    first = [float(value) for value in 5.0 + 0.1 * rng.normal(size=n)]
    second = [value + gap_s + 0.01 * float(rng.normal()) for value in first]
    of_second: list[float | None] = [None] * lost + second[lost:]
    trials = [*series("a", list(first)), *series("b", of_second)]
    rows = [contrast.to_row() for contrast in contrast_all(trials)]
    return {"comparisons": compare_all(trials), "contrasts": rows}


def test_success_comes_first_then_one_answer_of_each_task_then_what_cannot_be_told() -> None:
    tasks = {
        "same": compared("same", 0.0),
        "slower": compared("slower", 2.0),
        "lossy": compared("lossy", 0.0, lost=12),
    }
    found = headlines(tasks)
    assert [one.task for one in found] == ["lossy", "slower", "same"]
    assert [one.success_differs for one in found] == [True, False, False]
    assert [one.tells for one in found] == [True, True, False]


def test_headlines_are_five_at_most_and_the_last_one_says_what_they_cannot_tell() -> None:
    tasks = {f"task{k}": compared(f"task{k}", 1.0) for k in range(6)}
    assert len(headline_sentences(tasks, Words("en"))) == 5
    both = {**tasks, "same": compared("same", 0.0)}
    sentences = headline_sentences(both, Words("en"))
    assert len(sentences) == 5
    assert sentences[-1].startswith("Cannot tell a and b apart on same")
    assert headline_sentences({}, Words("en")) == []


def test_a_task_is_answered_under_the_condition_with_most_trials() -> None:
    few = series("a", [5.0] * 3) + series("b", [6.0] * 3)
    many = [
        replace(one, condition="randomised")
        for one in series("a", [5.0] * 20) + series("b", [None] * 20)
    ]
    rows = {"comparisons": compare_all([*few, *many]), "contrasts": []}
    (found,) = headlines({"rod_carry": rows})
    assert (found.condition, found.trials_n) == ("randomised", 20)
    assert sentence(found, Words("en")).startswith("On rod_carry under randomised, a succeeds")


def test_many_comparisons_need_more_evidence_than_one() -> None:
    one = answer("a", [*series("a", [5.0] * 6), *series("b", [None] * 6)])
    assert one.success_differs  # p = 0.031
    assert not corrected([one, one])[0].success_differs
    assert [made.p_value for made in corrected([one])] == [one.p_value]


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
