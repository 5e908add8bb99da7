"""RMS jerk against analytic motions, and its independence of the sampling rate."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.demos import quality
from minidual.errors import DataError


def sinusoid(frequency_hz: float, rate_hz: float, duration_s: float = 8.0) -> np.ndarray:
    t = np.arange(0.0, duration_s + 1e-9, 1.0 / rate_hz)
    return 0.3 * np.sin(2 * np.pi * frequency_hz * t[:, None] + np.arange(14))


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 250.0, 1000.0])
@pytest.mark.parametrize("frequency_hz", [0.5, 1.0, 3.0, 5.0])
def test_a_sinusoid_gives_its_analytic_jerk_at_every_rate(
    frequency_hz: float,
    rate_hz: float,
) -> None:
    expected = np.sqrt(14) * 0.3 * (2 * np.pi * frequency_hz) ** 3 / np.sqrt(2)
    # Forward and backward, the amplitude response is |H|^2 = 1 / (1 + (f / fc)^8).
    expected /= 1 + (frequency_hz / quality.CUTOFF_HZ) ** 8
    assert quality.rms_jerk(sinusoid(frequency_hz, rate_hz), rate_hz) == pytest.approx(
        expected,
        rel=0.01,
    )


def test_the_same_smooth_motion_gives_the_same_number_at_50_hz_and_1_khz() -> None:
    def motion(rate_hz: float) -> np.ndarray:
        s = np.clip((np.arange(0.0, 6.0 + 1e-9, 1.0 / rate_hz) - 1.0) / 4.0, 0.0, 1.0)
        blend = s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)  # rest to rest, jerk zero at both ends
        return blend[:, None] * np.linspace(-1.0, 1.0, 14)

    slow, fast = (quality.rms_jerk(motion(rate), rate) for rate in (50.0, 1000.0))
    assert slow == pytest.approx(fast, rel=0.01)
    assert fast > 0.1


def test_contact_noise_far_above_the_cutoff_is_left_out_and_jerky_motion_is_not() -> None:
    rate = 1000.0
    t = np.arange(0.0, 4.0, 1.0 / rate)
    clean = quality.rms_jerk(sinusoid(1.0, rate, 4.0), rate)
    buzz = sinusoid(1.0, rate, 4.0)[: len(t)] + 1e-4 * np.sin(2 * np.pi * 120.0 * t)[:, None]
    assert quality.rms_jerk(buzz, rate) == pytest.approx(clean, rel=0.01)
    steps = sinusoid(1.0, rate, 4.0)[: len(t)] + 0.05 * (np.floor(2 * t) % 2)[:, None]
    assert quality.rms_jerk(steps, rate) > 5 * clean


def test_a_motion_at_rest_has_no_jerk_whatever_its_offset() -> None:
    assert quality.rms_jerk(np.full((500, 14), 2.345678), 50.0) < 1e-6


def test_the_filter_text_states_what_the_code_does() -> None:
    text = quality.JERK_FILTER
    for fact in ("order 4", "10 Hz", "1 kHz", "0.2 s", "norm over all joints", "zero phase"):
        assert fact in text
    assert (quality.FILTER_ORDER, quality.CUTOFF_HZ, quality.INTERNAL_RATE_HZ) == (4, 10.0, 1000.0)
    assert quality.TRIM_S == 0.2


@pytest.mark.parametrize(
    ("q", "rate", "words"),
    [
        (np.zeros((10, 14)), 50.0, "at least 0.50 s"),
        (np.zeros(500), 50.0, "shape"),
        (np.full((500, 14), np.nan), 50.0, "NaN"),
        (np.zeros((500, 14)), 20.0, "at least 40 Hz"),
        (np.zeros((500, 14)), float("nan"), "40 Hz"),
    ],
)
def test_a_motion_that_has_no_meaningful_jerk_is_refused(
    q: np.ndarray,
    rate: float,
    words: str,
) -> None:
    with pytest.raises(DataError, match=words):
        quality.rms_jerk(q, rate)
