"""Statistics of single signals: scatter of a resting one, steps and turns of a moving one."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

SCATTERS = 2.9
"""Threshold in RMS scatters.

It is five standard deviations per coordinate: white noise exceeds it twice in a row once in a
billion samples.
"""
TURNS = 4
TURNS_S = 0.2
"""A signal that turns back TURNS times in this time jitters."""
_LEARNT = 10
"""Samples before the learnt scatter is used."""
_UNLEARNT = 4.0
"""Threshold before that, relative to the least one."""


@dataclass
class _Channel:
    """One coordinate: its least threshold, and the samples that it has learnt from."""

    least: float
    squares: float = 0.0
    samples: int = 0

    def is_exceeded(self, away: float) -> bool:
        if self.samples < _LEARNT:
            threshold = _UNLEARNT * self.least
        else:
            threshold = max(self.least, SCATTERS * math.sqrt(self.squares / self.samples))
        return not away <= threshold  # true for NaN


class Scatter:
    """RMS scatter (distance [m], angle [rad]) of a resting object's readings.

    Args:
        least: (2,), least thresholds.
    """

    def __init__(self, least: Sequence[float]) -> None:
        self._channels = [_Channel(threshold) for threshold in least]

    def exceeded(self, away: Sequence[float]) -> list[bool]:
        """Return which of away (2,) noise does not explain, such as NaN."""
        return [channel.is_exceeded(x) for x, channel in zip(away, self._channels, strict=True)]

    def learn(self, away: Sequence[float]) -> None:
        """Add a reading (2,) of an unmoved object; outliers are left out."""
        for x, channel in zip(away, self._channels, strict=True):
            if not channel.is_exceeded(x):
                channel.squares += x * x
                channel.samples += 1


class Turns:
    """Steps of a signal that are no noise, and its turns.

    Args:
        step: Least change that is no noise.

    Attributes:
        moved_s: Time of the last step; -inf before the first.
    """

    def __init__(self, step: float) -> None:
        self._step = step
        self._stepped_to = math.inf
        self._direction = 0
        self._high = -math.inf  # since the last turn
        self._low = math.inf
        self._turns_s: deque[float] = deque(maxlen=TURNS)
        self.moved_s = -math.inf

    def update(self, value: float, now_s: float) -> bool:
        """Take a value; return whether the signal jitters."""
        step = self._step
        if abs(value - self._stepped_to) >= step:
            self._stepped_to = value
            self.moved_s = now_s
        self._high = max(self._high, value)
        self._low = min(self._low, value)
        falls = self._direction >= 0 and self._high - value >= step
        rises = self._direction <= 0 and value - self._low >= step
        if falls or rises:
            if self._direction != 0:
                self._turns_s.append(now_s)
            self._direction = -1 if falls else 1
            self._high = value
            self._low = value
        return len(self._turns_s) == TURNS and now_s - self._turns_s[0] < TURNS_S
