"""What a bench gets and gives: inputs, rows of numbers with limits, a table as text."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from minidual.config.root import Config


@dataclass(frozen=True)
class BenchInputs:
    """What a bench may use.

    Attributes:
        config: The resolved configuration.
        seed: The run's seed.
        repeats_n: How often the thing is timed: steps, queries.
        advance: Call with the name of what was just measured.
        peers: Whether other planners are measured too.
        roboplan: Python with roboplan.
    """

    config: Config
    seed: int
    repeats_n: int
    advance: Callable[[str], None] = lambda _what: None
    peers: bool = False
    roboplan: Path = Path(".venv-roboplan/bin/python")


@dataclass(frozen=True)
class BenchRow:
    """One thing that was timed.

    Attributes:
        name: What, unique in its table.
        numbers: By column; names carry their unit, `step_us`. Integers are counts.
        limits: Columns whose number must not exceed a value.
    """

    name: str
    numbers: Mapping[str, float]
    limits: Mapping[str, float]

    @property
    def exceeded(self) -> tuple[str, ...]:
        """Columns over their limits; a number that is not finite is."""
        return tuple(
            column for column, limit in self.limits.items() if not self.numbers[column] <= limit
        )


@dataclass(frozen=True)
class BenchTable:
    """What a bench has measured.

    Attributes:
        title: One line.
        columns: Names of the numbers, in order; a row may lack some.
        rows: At least one.
        notes: How to read it.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[BenchRow, ...]
    notes: tuple[str, ...] = ()

    @property
    def exceeded(self) -> list[str]:
        """One sentence for every limit that does not hold."""
        return [
            f"{row.name}: {column} {row.numbers[column]:.2f}, limit {row.limits[column]:g}"
            for row in self.rows
            for column in row.exceeded
        ]

    def lines(self) -> list[str]:
        """Return the table as text; a number over its limit is marked with `!`."""
        cells = [["", *self.columns]]
        for row in self.rows:
            marks = set(row.exceeded)
            cells.append(
                [
                    row.name,
                    *(self._cell(row, column, over=column in marks) for column in self.columns),
                ],
            )
        widths = [max(len(line[i]) for line in cells) for i in range(len(cells[0]))]
        rows = [
            "  ".join(
                [
                    line[0].ljust(widths[0]),
                    *(c.rjust(w) for c, w in zip(line[1:], widths[1:], strict=True)),
                ],
            )
            for line in cells
        ]
        return [self.title, "", *(row.rstrip() for row in rows), "", *self.notes]

    @staticmethod
    def _cell(row: BenchRow, column: str, *, over: bool) -> str:
        if column not in row.numbers:
            return "-"
        if isinstance(row.numbers[column], int):
            return str(row.numbers[column])
        limit = f" (<= {row.limits[column]:g})" if column in row.limits else ""
        return f"{'!' if over else ''}{row.numbers[column]:.{_digits(row.numbers[column])}f}{limit}"


def _digits(number: float) -> int:
    return 2 if abs(number) < 10.0 else 1 if abs(number) < 100.0 else 0


Bench = Callable[[BenchInputs], BenchTable]
