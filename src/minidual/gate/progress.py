"""Progress that a stage reports, whoever listens: a bar on a terminal, plain lines elsewhere, or nobody."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import Protocol, Self


class Task(Protocol):
    """One piece of counted work. Also a context manager, so that it ends whatever happens."""

    def advance(self, steps: float = 1, note: str = "") -> None:
        """Count `steps` as done; `note` is a few words shown beside the bar ("loss 0.12")."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Progress(Protocol):
    """Where a stage tells how far it is."""

    def task(self, description: str, total: float | None = None) -> Task:
        """Begin a task: `with progress.task("trials", 20) as task: ... task.advance()`."""
        ...

    def note(self, message: str) -> None:
        """Say one line to the person watching."""


class PlainTask:
    """Says a line at the start, at most one every `every_s` seconds, and one at the end."""

    def __init__(self, description: str, total: float | None, say: Callable[[str], None], every_s: float) -> None:
        self._description = description
        self._total = total
        self._say = say
        self._every_s = every_s
        self._done = 0.0
        self._note = ""
        self._started = self._last = time.monotonic()

    def advance(self, steps: float = 1, note: str = "") -> None:
        """Count `steps` as done and say so if the last line is old enough."""
        self._done += steps
        self._note = note or self._note
        now = time.monotonic()
        if now - self._last >= self._every_s:
            self._last = now
            self._say(self._line(now))

    def _line(self, now: float) -> str:
        spent = now - self._started
        of = "" if self._total is None else f"/{self._total:g}"
        line = f"{self._description}: {self._done:g}{of}, {spent:.0f} s"
        if self._total is not None and 0 < self._done < self._total:
            line += f", about {spent * (self._total - self._done) / self._done:.0f} s left"
        return f"{line}, {self._note}" if self._note else line

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._say(self._line(time.monotonic()) + (" (stopped)" if kind is not None else ""))


class PlainProgress:
    """Plain lines through `say` (a function that prints one line), for logs and pipes."""

    def __init__(self, say: Callable[[str], None], every_s: float = 10.0) -> None:
        self._say = say
        self._every_s = every_s

    def task(self, description: str, total: float | None = None) -> PlainTask:
        """Begin a task that reports in plain lines."""
        return PlainTask(description, total, self._say, self._every_s)

    def note(self, message: str) -> None:
        """Say one line."""
        self._say(message)


class SilentProgress(PlainProgress):
    """Nobody listens: for tests and for use as a library."""

    def __init__(self) -> None:
        super().__init__(lambda _line: None, every_s=float("inf"))
