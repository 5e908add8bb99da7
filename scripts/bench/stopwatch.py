"""Processor time by part."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import wraps


class Stopwatch:
    """Sums processor time by part; the innermost part that runs gets it.

    Attributes:
        seconds: By part.
    """

    def __init__(self, clock: Callable[[], float] = time.process_time) -> None:
        self.seconds: Counter[str] = Counter()
        self._clock = clock
        self._running: list[str] = []
        self._since_s = 0.0

    @contextmanager
    def running(self, part: str) -> Generator[None]:
        """Count time for a part."""
        self._count()
        self._running.append(part)
        try:
            yield
        finally:
            self._count()
            self._running.pop()

    def timed[**P, R](self, part: str, function: Callable[P, R]) -> Callable[P, R]:
        """Return a function whose time counts for a part."""

        @wraps(function)
        def wrapper(*arguments: P.args, **named: P.kwargs) -> R:
            with self.running(part):
                return function(*arguments, **named)

        return wrapper

    def _count(self) -> None:
        now_s = self._clock()
        if self._running:
            self.seconds[self._running[-1]] += now_s - self._since_s  # type: ignore[assignment]
        self._since_s = now_s
