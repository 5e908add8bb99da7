"""Consoles and progress: bars on a terminal, plain lines elsewhere."""

import os
import sys
from collections.abc import Iterable
from typing import Self

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as RichBars
from rich.segment import Segment

from minidual.errors import printable
from minidual.gate.progress import Progress, ProgressTask

_LOG_WIDTH = 160


class SafeConsole(Console):
    """Shows no control sequence of what it prints; its own colours and bars stay."""

    def render(
        self,
        renderable: RenderableType,
        options: ConsoleOptions | None = None,
    ) -> Iterable[Segment]:
        """Yield segments without control and direction characters."""
        for segment in super().render(renderable, options):
            if segment.control:
                yield segment
            else:
                yield segment._replace(text=printable(segment.text))


def console(*, stderr: bool) -> Console:
    """Return a console on stderr or stdout."""
    stream = sys.stderr if stderr else sys.stdout
    # Off a terminal rich assumes 80 columns, if COLUMNS does not say so, and would fold log lines.
    width_is_known = stream.isatty() or "COLUMNS" in os.environ
    return SafeConsole(
        stderr=stderr,
        highlight=False,
        width=None if width_is_known else _LOG_WIDTH,
    )


class BarTask(ProgressTask):
    """One bar; nested tasks draw theirs below."""

    def __init__(self, console: Console, description: str, total: float | None) -> None:
        self._bars = RichBars(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}"),
            console=console,
        )
        self._bar = self._bars.add_task(description, total=total, note="")

    def advance(self, steps: float = 1, note: str = "") -> None:
        """See `ProgressTask`."""
        self._bars.update(self._bar, advance=steps)
        if note:
            self._bars.update(self._bar, note=note)

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bars.stop()


class ConsoleProgress(Progress):
    """Bars on a terminal, plain lines elsewhere."""

    def __init__(self, console: Console) -> None:
        def say(line: str) -> None:
            console.print(line, markup=False, highlight=False, soft_wrap=True)

        super().__init__(say)
        self._console = console

    def task(self, description: str, total: float | None = None) -> ProgressTask:
        """Begin a bar or plain lines."""
        if self._console.is_terminal:
            return BarTask(self._console, description, total)
        return super().task(description, total)
