"""Frame timing and simulation speed."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

Clock = Callable[[], float]


class Metronome:
    """Limits frames to `rate_hz` of wall time."""

    def __init__(self, rate_hz: float, clock: Clock = time.monotonic) -> None:
        self._clock = clock
        self._period_s = 1.0 / rate_hz
        self._next_s = float("-inf")

    def due(self) -> bool:
        """Return whether the period is over."""
        return self._clock() >= self._next_s

    def done(self, slower: float = 1.0) -> None:
        """Note a frame; the next is due after `slower` periods."""
        self._next_s = self._clock() + self._period_s * slower


class SpeedMeter:
    """Simulated per wall-clock seconds over `window_s`."""

    def __init__(self, window_s: float = 1.0, clock: Clock = time.monotonic) -> None:
        self._clock = clock
        self._window_s = window_s
        self._seen: deque[tuple[float, float]] = deque()

    def add(self, time_s: float) -> float | None:
        """Add a simulated time; return the speed once known."""
        now = self._clock()
        if self._seen and time_s < self._seen[-1][1]:
            self._seen.clear()  # the simulation was reset
        self._seen.append((now, time_s))
        while len(self._seen) > 2 and now - self._seen[0][0] > self._window_s:
            self._seen.popleft()
        wall = now - self._seen[0][0]
        return (time_s - self._seen[0][1]) / wall if wall > 0.0 else None


class Brake:
    """Limits simulated time to `speed` times wall time."""

    def __init__(
        self, speed: float, clock: Clock = time.monotonic, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self._speed, self._clock, self._sleep = speed, clock, sleep
        self._start: tuple[float, float] | None = None
        self._last_s = 0.0

    def hold(self, time_s: float) -> None:
        """Sleep until `time_s` is allowed; lags over 0.1 s are not caught up."""
        now = self._clock()
        if self._start is None or time_s < self._last_s:
            self._start = (now, time_s)
        self._last_s = time_s
        ahead = (time_s - self._start[1]) / self._speed - (now - self._start[0])
        if ahead > 0.0:
            self._sleep(ahead)
        elif ahead < -0.1:
            self._start = (now, time_s)
