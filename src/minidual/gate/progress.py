"""Progress of a stage as plain lines; `minidual.cli.console` draws bars."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager

_EVERY_S = 10.0


class Task(AbstractContextManager["Task"]):
    """Counted work, a context manager. Prints a line at most every 10 s, and one at the end."""

    def __init__(self, description: str, total: float | None, say: Callable[[str], None]) -> None:
        self._description, self._total, self._say = description, total, say
        self._done, self._note = 0.0, ""
        self._first: tuple[float, float] | None = None  # time and count of the first call, of earlier work perhaps
        self._started = self._last = time.monotonic()

    def advance(self, steps: float = 1, note: str = "") -> None:
        """Count `steps`; `note` ("loss 0.12") is shown beside the count."""
        self._done += steps
        self._note = note or self._note
        now = time.monotonic()
        self._first = self._first or (now, self._done)
        if now - self._last >= _EVERY_S:
            self._last = now
            self._say(self._line(now))

    def _line(self, now: float) -> str:
        spent = now - self._started
        of = "" if self._total is None else f"/{self._total:g}"
        line = f"{self._description}: {self._done:g}{of}, {spent:.0f} s"
        since, before = self._first or (now, self._done)
        if self._total is not None and before < self._done < self._total:
            line += f", about {(now - since) * (self._total - self._done) / (self._done - before):.0f} s left"
        return f"{line}, {self._note}" if self._note else line

    def __exit__(self, *error: object) -> None:
        self._say(self._line(time.monotonic()) + (" (stopped)" if any(error) else ""))


class Progress:
    """Plain lines through `say`; silent by default."""

    def __init__(self, say: Callable[[str], None] = lambda line: None) -> None:
        self.note = say
        """Shows one line."""

    def task(self, description: str, total: float | None = None) -> Task:
        """Begin a task: `with progress.task("trials", 20) as task: ... task.advance()`."""
        return Task(description, total, self.note)
