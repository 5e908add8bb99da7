"""Progress of long work, as plain lines."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager

_EVERY_S = 10.0


class ProgressTask(AbstractContextManager["ProgressTask"]):
    """Counted work, a context manager. Prints a line at most every 10 s, and one at the end."""

    def __init__(self, description: str, total: float | None, say: Callable[[str], None]) -> None:
        self._description = description
        self._total = total
        self._say = say
        self._done = 0.0
        self._note = ""
        # Time and count of the first call, which may count earlier work.
        self._first: tuple[float, float] | None = None
        self._started = time.monotonic()
        self._last = self._started

    def advance(self, steps: float = 1, note: str = "") -> None:
        """Count `steps`; `note` ("loss 0.12") is shown beside the count."""
        self._done += steps
        if note:
            self._note = note
        now = time.monotonic()
        if self._first is None:
            self._first = (now, self._done)
        if now - self._last >= _EVERY_S:
            self._last = now
            self._say(self._line(now))

    def _line(self, now: float) -> str:
        total = "" if self._total is None else f"/{self._total:g}"
        line = f"{self._description}: {self._done:g}{total}, {now - self._started:.0f} s"
        left_s = self._left_s(now)
        if left_s is not None:
            line += f", about {left_s:.0f} s left"
        return f"{line}, {self._note}" if self._note else line

    def _left_s(self, now: float) -> float | None:
        """Return the estimated time to the end, from the rate since the first call."""
        if self._first is None or self._total is None:
            return None
        since, before = self._first
        if not before < self._done < self._total:
            return None
        return (now - since) * (self._total - self._done) / (self._done - before)

    def __exit__(self, *error: object) -> None:
        self._say(self._line(time.monotonic()) + (" (stopped)" if any(error) else ""))


class Progress:
    """Plain lines through `say`; silent by default."""

    def __init__(self, say: Callable[[str], None] = lambda line: None) -> None:
        self.note = say
        """Shows one line."""

    def task(self, description: str, total: float | None = None) -> ProgressTask:
        """Begin a task: `with progress.task("trials", 20) as task: ... task.advance()`."""
        return ProgressTask(description, total, self.note)
