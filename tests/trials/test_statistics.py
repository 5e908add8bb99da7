"""Intervals and tests against published values and simulation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from minidual.errors import NothingEvaluatedError, UsageError
from minidual.trials import statistics
from minidual.trials.statistics import (
    bootstrap_median_interval,
    holm,
    mcnemar_p_value,
    paired_rate_interval,
    wilson_interval,
)


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [
        (8, 10, 0.4902, 0.9433),
        (16, 20, 0.5840, 0.9193),
        (0, 20, 0.0, 0.1611),
        (20, 20, 0.8389, 1.0),
        (81, 263, 0.2553, 0.3662),  # Newcombe, Statistics in Medicine 17 (1998), table I
        (15, 148, 0.0624, 0.1605),  # the same
        (1, 29, 0.0061, 0.1718),  # the same
    ],
)
def test_wilson_against_known_values(successes: int, n: int, low: float, high: float) -> None:
    assert wilson_interval(successes, n) == pytest.approx((low, high), abs=5e-5)


def test_wilson_against_scipy() -> None:
    for successes, n in ((0, 1), (1, 1), (3, 7), (49, 50), (98, 100)):
        expected = stats.binomtest(successes, n).proportion_ci(0.95, method="wilson")
        assert wilson_interval(successes, n) == pytest.approx(
            (expected.low, expected.high),
            abs=1e-9,
        )


def test_wilson_refuses_what_has_no_interval() -> None:
    with pytest.raises(NothingEvaluatedError):
        wilson_interval(0, 0)
    for successes, n in ((5, 4), (-1, 4)):
        with pytest.raises(UsageError, match="there must be 0 to 4"):
            wilson_interval(successes, n)


def test_the_bootstrap_covers_the_median_as_often_as_it_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(statistics, "_RESAMPLES_N", 400)
    rng = np.random.default_rng(5)
    hits = 0
    for _ in range(200):
        low, high = bootstrap_median_interval(rng.exponential(1.0, 41), rng)
        hits += low <= np.log(2) <= high
    assert 0.90 <= hits / 200 <= 0.99


def test_the_bootstrap_repeats_with_its_seed_and_gives_nan_for_nonsense() -> None:
    values = np.random.default_rng(0).normal(size=20)
    first, second = (bootstrap_median_interval(values, np.random.default_rng(1)) for _ in range(2))
    assert first == second
    assert first[0] <= np.median(values) <= first[1]
    assert bootstrap_median_interval([3.0], np.random.default_rng(0)) == (3.0, 3.0)
    for nonsense in ([], [1.0, np.nan], [np.inf]):
        assert np.isnan(bootstrap_median_interval(nonsense, np.random.default_rng(0))).all()


def test_the_paired_test_is_mcnemars_exact_test() -> None:
    for first, second in ((10, 2), (2, 10), (1, 1), (0, 7), (3, 4)):
        assert mcnemar_p_value(first, second) == pytest.approx(
            stats.binomtest(first, first + second, 0.5).pvalue,
        )
    assert mcnemar_p_value(0, 0) == 1.0


@pytest.mark.parametrize(
    ("table", "low", "high"),
    [
        # Without a correlation it is Newcombe's interval of independent rates (Statistics in
        # Medicine 17 (1998) 873, method 10), from the Wilson ends of tests above: 16 of 20 against
        # 0 of 20, and 20 of 20 against itself.
        ((0, 16, 0, 4), 0.8 - float(np.hypot(0.8 - 0.5840, 0.1611)), 0.8 + (0.9193 - 0.8)),
        ((20, 0, 0, 0), -(1.0 - 0.8389), 1.0 - 0.8389),
    ],
)
def test_the_paired_interval_of_rates_against_its_parts(
    table: tuple[int, int, int, int],
    low: float,
    high: float,
) -> None:
    assert paired_rate_interval(*table) == pytest.approx((low, high), abs=2e-4)


def test_the_paired_interval_of_rates_is_corrected_for_continuity() -> None:
    """A negative correlation stays; a positive one shrinks by half a pair, at most to none."""
    assert paired_rate_interval(36, 12, 2, 0) == pytest.approx(
        (0.0569, 0.3404),
        abs=1e-4,
    )  # Newcombe's example
    first = wilson_interval(17, 20)
    second = wilson_interval(14, 20)
    low = np.hypot(0.85 - first[0], second[1] - 0.7)
    high = np.hypot(first[1] - 0.85, 0.7 - second[0])
    assert paired_rate_interval(12, 5, 2, 1) == pytest.approx(
        (0.15 - low, 0.15 + high),
    )  # 12 * 1 - 5 * 2 = 2 < 10
    a = wilson_interval(31, 50)
    b = wilson_interval(30, 50)
    phi = (30 * 19 - 25) / np.sqrt(31 * 19 * 30 * 20)
    down = (0.62 - a[0], b[1] - 0.6)
    up = (a[1] - 0.62, 0.6 - b[0])
    low, high = (np.sqrt(x * x - 2 * phi * x * y + y * y) for x, y in (down, up))
    assert paired_rate_interval(30, 1, 0, 19) == pytest.approx((0.02 - low, 0.02 + high))


@pytest.mark.parametrize("table", [(12, 5, 2, 1), (0, 16, 0, 4), (3, 0, 9, 8), (30, 1, 0, 19)])
def test_the_paired_interval_of_rates_turns_round_with_its_pair(
    table: tuple[int, int, int, int],
) -> None:
    both, first, second, neither = table
    low, high = paired_rate_interval(*table)
    assert paired_rate_interval(both, second, first, neither) == pytest.approx((-high, -low))
    assert -1.0 <= low <= (first - second) / sum(table) <= high <= 1.0


@pytest.mark.parametrize(
    ("shares", "n"),
    [((0.7, 0.15, 0.1, 0.05), 20), ((0.5, 0.4, 0.02, 0.08), 20), ((0.9, 0.1, 0, 0), 50)],
)
def test_the_paired_interval_of_rates_covers_as_often_as_it_says(
    shares: tuple[float, ...],
    n: int,
) -> None:
    """Simulated pairs: the truth is inside in about 95 % of the draws; agreement narrows it."""
    tables = np.random.default_rng(11).multinomial(n, shares, 2000)
    truth = shares[1] - shares[2]
    different, counts = np.unique(tables, axis=0, return_counts=True)
    ends = np.array([paired_rate_interval(*map(int, row)) for row in different])
    inside = (ends[:, 0] <= truth) & (truth <= ends[:, 1])
    covered = float(np.average(inside, weights=counts))
    assert 0.93 <= covered <= 0.995


def test_pairs_that_agree_give_a_narrower_interval_than_pairs_that_do_not() -> None:
    agree = paired_rate_interval(50, 0, 0, 50)
    differ = paired_rate_interval(25, 25, 25, 25)
    assert agree[1] - agree[0] < 0.3 * (differ[1] - differ[0])


def test_an_interval_of_no_pairs_is_refused() -> None:
    with pytest.raises(NothingEvaluatedError):
        paired_rate_interval(0, 0, 0, 0)


def test_holms_correction_against_its_definition() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.02]) == [0.02]
    assert holm([0.4, 0.6]) == [0.8, 0.8]
    assert holm([]) == []
    for bad in (1.1, -0.1, float("nan")):
        with pytest.raises(UsageError, match="no probability"):
            holm([0.5, bad])
