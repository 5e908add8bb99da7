"""The terminal, and progress on stderr: bars on a terminal, plain lines elsewhere."""

import sys
from collections.abc import Iterable
from typing import Self

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as RichBars
from rich.segment import Segment

from minidual.errors import printable
from minidual.gate.stage import Progress, Task


class SafeConsole(Console):
    """Shows no control sequence of what it prints; its own colours and bars stay."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield segments without control and direction characters."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=printable(segment.text))


def console(*, stderr: bool) -> Console:
    """Return a console on stderr or stdout."""
    stream = sys.stderr if stderr else sys.stdout
    # Off a terminal rich assumes 80 columns and would fold log lines.
    return SafeConsole(stderr=stderr, highlight=False, width=None if stream.isatty() else 160)


class BarTask(Task):
    """One bar; nested tasks draw theirs below."""

    def __init__(self, console: Console, description: str, total: float | None) -> None:
        columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        texts = TextColumn("{task.description}"), TextColumn("{task.fields[note]}")
        self._bars = RichBars(texts[0], *columns, texts[1], console=console)
        self._bar = self._bars.add_task(description, total=total, note="")

    def advance(self, steps: float = 1, note: str = "") -> None:
        """See `Task`."""
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
        super().__init__(lambda line: console.print(line, markup=False, highlight=False, soft_wrap=True))
        self._console = console

    def task(self, description: str, total: float | None = None) -> Task:
        """Begin a bar or plain lines."""
        bars = self._console.is_terminal
        return BarTask(self._console, description, total) if bars else super().task(description, total)
