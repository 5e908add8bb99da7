"""Paired comparisons: what is shared, what it costs, and that nothing depends on order."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from minidual.errors import DataError
from minidual.trials.comparisons import NO_PAIR, compare_all, compare_with_clean
from minidual.trials.metrics import TrialMetrics

CONDITIONS = ("clean", "push +x")


def trial(
    method: str,
    condition: str,
    index: int,
    *,
    success: bool = True,
    duration_s: float = 6.0,
) -> TrialMetrics:
    nan = math.nan
    return TrialMetrics(
        method,
        index,
        condition,
        success,
        "" if success else "held",
        "",
        nan if success else 3.0,
        duration_s if success else nan,
        0.7,
        20.0,
        0.001,
        1.4,
        39.0,
        60.0,
        0.001,
    )


@pytest.fixture
def trials() -> list[TrialMetrics]:
    """Twelve clean and eight pushed starts.

    `slow` takes 1 s longer, and a push costs it every second start.
    """
    noise = np.random.default_rng(2).normal(0.0, 0.1, 20)
    made = [
        trial("fast", c, i, duration_s=6.0 + noise[i])
        for c in CONDITIONS
        for i in range(12 if c == "clean" else 8)
    ]
    for one in list(made):
        lost = one.condition != "clean" and one.index % 2 == 0
        made.append(
            trial(
                "slow",
                one.condition,
                one.index,
                success=not lost,
                duration_s=one.duration_s + 1.0 + 0.01 * one.index,
            ),
        )
    return made


def test_methods_are_compared_on_shared_starts_condition_by_condition(
    trials: list[TrialMetrics],
) -> None:
    clean, pushed = compare_all(trials, 3)
    assert [(r["condition"], r["first"], r["second"]) for r in (clean, pushed)] == [
        (c, "fast", "slow") for c in CONDITIONS
    ]
    assert (clean["trials_n"], pushed["trials_n"], pushed["only_first_n"]) == (12, 8, 4)
    assert pushed["rate_difference"] == 0.5
    assert clean["duration_difference_s"] == pytest.approx(-1.055)
    assert (
        -1.11
        <= clean["duration_difference_low_s"]
        <= -1.055
        <= clean["duration_difference_high_s"]
        <= -1.0
    )
    assert pushed["duration_difference_s"] == pytest.approx(-1.04)  # starts 1, 3, 5, 7 alone


def test_a_disturbance_is_counted_against_the_same_starts_undisturbed(
    trials: list[TrialMetrics],
) -> None:
    rows = {r["method"]: r for r in compare_with_clean(trials, 3)}
    assert set(rows) == {"fast", "slow"}
    assert (rows["slow"]["first"], rows["slow"]["second"], rows["slow"]["trials_n"]) == (
        "push +x",
        "clean",
        8,
    )
    assert rows["slow"]["rate_difference"] == -0.5
    assert rows["slow"]["p_value"] == pytest.approx(0.125)
    assert rows["fast"]["rate_difference"] == 0.0
    assert rows["fast"]["rate_difference_low"] < 0.0 < rows["fast"]["rate_difference_high"]
    assert compare_with_clean([t for t in trials if t.condition != "clean"]) == []


def test_rows_depend_on_neither_order_nor_company(trials: list[TrialMetrics]) -> None:
    rows = compare_all(trials, 3)
    turned = compare_all(trials[::-1], 3)
    for row in rows:
        (other,) = [r for r in turned if r["condition"] == row["condition"]]
        assert (other["first"], other["second"]) == (row["second"], row["first"])
        for name in ("rate_difference", "duration_difference"):
            unit = "_s" if name.startswith("duration") else ""
            assert other[f"{name}_low{unit}"] == pytest.approx(
                -row[f"{name}_high{unit}"],
                abs=1e-12,
            )
    assert compare_all([t for t in trials if t.condition == "clean"], 3) == rows[:1]


def test_without_a_shared_success_there_is_no_difference_of_time() -> None:
    rows = [trial("a", "clean", 0), trial("b", "clean", 0, success=False)]
    (row,) = compare_all(rows)
    assert row["duration_difference_s"] == row["duration_difference_low_s"] == NO_PAIR
    assert compare_all([rows[0], replace(rows[1], index=1)]) == []


@pytest.mark.parametrize("time_s", [math.nan, math.inf])
def test_a_success_without_a_time_is_an_error_and_not_a_pair_less(time_s: float) -> None:
    rows = [
        trial(m, "clean", i, duration_s=time_s if (m, i) == ("b", 1) else 6.0)
        for m in "ab"
        for i in range(3)
    ]
    with pytest.raises(DataError, match="clean/a/b: a trial that succeeded has no completion time"):
        compare_all(rows)
