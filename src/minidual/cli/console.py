"""The terminal."""

import sys
from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from minidual.errors import printable


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
