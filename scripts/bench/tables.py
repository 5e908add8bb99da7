"""What a bench gets, and its table as text."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from minidual.config.root import Config
from minidual.show.report.bench import BenchRow, BenchTable

ROBOPLAN_PYTHON = Path(".venv-roboplan/bin/python")


def _silent(_name: str) -> None:
    pass


@dataclass(frozen=True)
class BenchInputs:
    """What a bench may use.

    Attributes:
        config: The resolved configuration.
        seed: The run's seed.
        repeats_n: How often each thing is timed: steps, queries.
        advance: Called with the name of what was just measured.
        peers: Whether the hard queries are planned with other planners too.
        roboplan: A Python that has roboplan.
    """

    config: Config
    seed: int
    repeats_n: int
    advance: Callable[[str], None] = _silent
    peers: bool = False
    roboplan: Path = ROBOPLAN_PYTHON


Bench = Callable[[BenchInputs], BenchTable]


def table_lines(table: BenchTable) -> list[str]:
    """Return the table as text; a number over its limit is marked with `!`."""
    cells = [["", *table.columns]]
    cells += [[row.name, *(_cell(row, column) for column in table.columns)] for row in table.rows]
    widths = [max(len(line[i]) for line in cells) for i in range(len(cells[0]))]
    lines = [_padded(line, widths) for line in cells]
    return [table.title, "", *lines, "", *table.notes]


def _padded(cells: list[str], widths: list[int]) -> str:
    """Return one line: the name to the left, the numbers to the right."""
    name, *numbers = cells
    name_width, *number_widths = widths
    columns = [name.ljust(name_width)]
    columns += [text.rjust(width) for text, width in zip(numbers, number_widths, strict=True)]
    return "  ".join(columns).rstrip()


def _cell(row: BenchRow, column: str) -> str:
    text = row.text(column)
    if column not in row.limits or column not in row.numbers:
        return text
    mark = "!" if column in row.exceeded else ""
    return f"{mark}{text} (<= {row.limits[column]:.3g})"
