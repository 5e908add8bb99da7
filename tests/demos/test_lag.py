"""The lag of the arms behind their leader is measured on the whole, and sample by sample."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.demos.lag import LAG_MAX_S, leader_lag

RATE_HZ = 100.0
TIMES_S = np.arange(400) / RATE_HZ


def motion(times_s: np.ndarray) -> np.ndarray:
    """Return two joints (T, 2) that sway."""
    return 0.3 * np.sin(2.0 * np.pi * np.column_stack([0.5 * times_s, 0.8 * times_s + 0.2]))


@pytest.mark.parametrize("lag_s", [0.0, 0.0237, 0.094])
def test_a_delayed_motion_has_its_delay(lag_s: float) -> None:
    lag = leader_lag(motion(TIMES_S), motion(TIMES_S - lag_s), RATE_HZ)
    assert lag.aligned_s == pytest.approx(lag_s, abs=0.001)
    assert np.percentile(lag.samples_s, [5, 50, 95]) == pytest.approx([lag_s] * 3, abs=0.004)


def test_a_part_that_is_later_shows_in_the_samples() -> None:
    delays_s = np.where(TIMES_S < 2.0, 0.02, 0.1)
    lag = leader_lag(motion(TIMES_S), motion(TIMES_S - delays_s), RATE_HZ)
    assert np.percentile(lag.samples_s, 10) == pytest.approx(0.02, abs=0.004)
    assert np.percentile(lag.samples_s, 90) == pytest.approx(0.1, abs=0.004)


def test_what_stands_still_has_no_lag() -> None:
    lag = leader_lag(np.zeros((200, 2)), np.zeros((200, 2)), RATE_HZ)
    assert np.isnan(lag.aligned_s)
    assert not len(lag.samples_s)


def test_no_lag_is_found_beyond_what_is_looked_for() -> None:
    lag = leader_lag(motion(TIMES_S), motion(TIMES_S - 0.5), RATE_HZ)
    assert lag.samples_s.max() < LAG_MAX_S
