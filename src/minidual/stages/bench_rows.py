"""What can be timed: one explicit table, each row a lazy target.

A bench measures something against a yardstick of the same run, because an absolute time says as much about the
machine and its other work as about the code. It returns a table of numbers and the limits they should keep; who asks
decides what follows from a limit that does not hold.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from minidual.config.root import Config
from minidual.errors import UsageError, unknown_name


@dataclass(frozen=True)
class BenchInputs:
    """What a bench may use.

    Attributes:
        config: The resolved configuration.
        seed: The run's seed.
        repeats_n: How often the thing is timed: steps, queries.
        advance: Call with the name of what was just measured.
    """

    config: Config
    seed: int
    repeats_n: int
    advance: Callable[[str], None] = lambda _what: None


@dataclass(frozen=True)
class BenchRow:
    """One thing that was timed.

    Attributes:
        name: What, unique in its table.
        numbers: By column; names carry their unit, `step_us`.
        limits: Columns whose number must not exceed a value.
    """

    name: str
    numbers: Mapping[str, float]
    limits: Mapping[str, float]

    @property
    def exceeded(self) -> tuple[str, ...]:
        """Columns over their limits; a number that is not finite is."""
        return tuple(column for column, limit in self.limits.items() if not self.numbers[column] <= limit)


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
            cells.append([row.name, *(self._cell(row, column, over=column in marks) for column in self.columns)])
        widths = [max(len(line[i]) for line in cells) for i in range(len(cells[0]))]
        rows = [
            "  ".join([line[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(line[1:], widths[1:], strict=True))])
            for line in cells
        ]
        return [self.title, "", *(row.rstrip() for row in rows), "", *self.notes]

    def to_json(self) -> dict[str, Any]:
        """Return the same as a document."""
        return {
            "title": self.title,
            "columns": list(self.columns),
            "rows": [
                {
                    "name": row.name,
                    "numbers": dict(row.numbers),
                    "limits": dict(row.limits),
                    "exceeded": list(row.exceeded),
                }
                for row in self.rows
            ],
            "notes": list(self.notes),
        }

    @staticmethod
    def _cell(row: BenchRow, column: str, *, over: bool) -> str:
        if column not in row.numbers:
            return "-"
        limit = f" (<= {row.limits[column]:g})" if column in row.limits else ""
        return f"{'!' if over else ''}{row.numbers[column]:.{_digits(row.numbers[column])}f}{limit}"


def _digits(number: float) -> int:
    return 2 if abs(number) < 10.0 else 1 if abs(number) < 100.0 else 0


@dataclass(frozen=True)
class BenchSpec:
    """One row of the table.

    Attributes:
        target: `module:function`; called as function(inputs: BenchInputs) it returns a BenchTable.
        summary: One line for people.
        repeats_n: How often it times by default.
    """

    target: str
    summary: str
    repeats_n: int

    def run(self, inputs: BenchInputs) -> BenchTable:
        """Measure."""
        module, function = self.target.split(":")
        measure: Any = getattr(importlib.import_module(module), function)
        return measure(inputs)


BENCHES: dict[str, BenchSpec] = {
    "control": BenchSpec(
        "minidual.stages.bench_control:measure",
        "one 1 kHz step of every controller against bare physics, arms free and holding the rod",
        2000,
    ),
    "planning": BenchSpec(
        "minidual.stages.bench_planning:measure",
        "planners and checkers on the stored hard queries, and the price of proof",
        20,
    ),
}


def parse_benches(names: Sequence[str]) -> tuple[str, ...]:
    """Return the benches named, each once; all of them if none is.

    Raises:
        UsageError: An unknown or repeated name.
    """
    for name in names:
        if name not in BENCHES:
            raise unknown_name("bench", name, BENCHES)
        if list(names).count(name) > 1:
            raise UsageError(f"bench '{name}' is named twice")
    return tuple(names) or tuple(BENCHES)
