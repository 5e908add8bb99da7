"""Progress on stderr: bars on a terminal, plain lines elsewhere."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as RichBars

from minidual.gate.progress import PlainProgress, Progress, Task


class BarTask:
    """One bar of a shared display."""

    def __init__(self, owner: BarProgress, description: str, total: float | None) -> None:
        self._owner = owner
        self._bars, self._task = owner.open(description, total)

    def advance(self, steps: float = 1, note: str = "") -> None:
        """Count `steps` as done; `note` is shown beside the bar."""
        self._bars.update(self._task, advance=steps)
        if note:
            self._bars.update(self._task, note=note)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop_task(self._task)
        self._owner.close()


class BarProgress:
    """Bars drawn by rich."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bars: RichBars | None = None
        self._open = 0

    def task(self, description: str, total: float | None = None) -> Task:
        """Begin a task."""
        return BarTask(self, description, total)

    def note(self, message: str) -> None:
        """Print one line above the bars."""
        self._console.print(message, markup=False, highlight=False)

    def open(self, description: str, total: float | None) -> tuple[RichBars, TaskID]:
        """Return the display, started if needed, and a new bar."""
        if self._bars is None:
            self._bars = RichBars(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TimeRemainingColumn(),
                TextColumn("{task.fields[note]}"),
                console=self._console,
            )
            self._bars.start()
        self._open += 1
        return self._bars, self._bars.add_task(description, total=total, note="")

    def close(self) -> None:
        """Stop the display after the last task."""
        self._open -= 1
        if self._open <= 0 and self._bars is not None:
            self._bars.stop()
            self._bars, self._open = None, 0


def progress_for(console: Console) -> Progress:
    """Return bars if `console` is a terminal, plain lines otherwise."""
    if console.is_terminal:
        return BarProgress(console)
    return PlainProgress(lambda line: console.print(line, markup=False, highlight=False, soft_wrap=True))
