"""Differences of motions: over shared successes, with interval and test."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from minidual.errors import DataError
from minidual.trials.contrasts import Contrast, contrast_all, paired_t_p_value
from minidual.trials.metrics import TrialMetrics
from tests.support.trial_results import BAD, result


def trials(method: str, n: int = 8, **changes: float) -> list[TrialMetrics]:
    """Return trials whose numbers differ a little from start to start."""
    return [
        result(
            index,
            method=method,
            duration_s=changes.get("duration_s", 7.9) + 0.1 * index,
            torque_ratio_max=changes.get("torque_ratio_max", 0.8) + 0.001 * index,
            jerk_rms=changes.get("jerk_rms", 22.0) + index,
            internal_force_min_n=changes.get("internal_force_min_n", 39.0) + 0.1 * index,
        )
        for index in range(n)
    ]


def by_quantity(rows: list[TrialMetrics]) -> dict[str, Contrast]:
    return {contrast.quantity: contrast for contrast in contrast_all(rows)}


def test_each_quantity_has_its_difference_interval_and_favoured_method() -> None:
    slow = trials("a", duration_s=9.0, jerk_rms=11.0, internal_force_min_n=30.0)
    rough = trials("b", duration_s=8.0, jerk_rms=33.0, internal_force_min_n=39.0)
    found = by_quantity([*slow, *rough])
    assert found["duration_s"].difference == pytest.approx(1.0)
    assert found["duration_s"].low <= 1.0 + 1e-9
    assert found["duration_s"].high >= 1.0 - 1e-9
    assert found["duration_s"].better == "b"
    assert found["jerk_rms"].better == "a"
    assert found["jerk_rms"].share == pytest.approx(22.0 / 36.5)
    assert found["internal_force_min_n"].better == "b"  # more of it is better
    assert found["pinch_force_min_n"].difference == 0.0
    assert found["pinch_force_min_n"].p_value == 1.0


def test_starts_on_which_one_fails_do_not_count() -> None:
    first, second = trials("a"), trials("b")
    second[0] = result(0, method="b", **BAD)
    second[1] = result(11, method="b")  # another start
    found = by_quantity([*first, *second])
    assert found["duration_s"].pairs_n == 6


def test_two_pairs_are_too_few_and_a_missing_force_has_no_contrast() -> None:
    assert contrast_all([*trials("a", 2), *trials("b", 2)]) == []
    forceless = [
        result(index, method="b", internal_force_min_n=math.nan, duration_s=8.0)
        for index in range(8)
    ]
    assert "internal_force_min_n" not in by_quantity([*trials("a"), *forceless])


def test_a_success_without_a_time_is_damaged_data() -> None:
    timeless = [result(index, method="b", duration_s=math.nan) for index in range(8)]
    with pytest.raises(DataError, match="no completion time"):
        contrast_all([*trials("a"), *timeless])


def test_the_t_test_is_that_of_scipy() -> None:
    values = np.random.default_rng(1).normal(0.4, 1.0, 12)
    assert paired_t_p_value(values) == pytest.approx(ttest_1samp(values, 0.0).pvalue)


@pytest.mark.parametrize(("values", "p_value"), [([0.0] * 5, 1.0), ([1.0] * 5, 0.0)])
def test_equal_differences_need_no_spread(values: list[float], p_value: float) -> None:
    assert paired_t_p_value(np.array(values)) == p_value
