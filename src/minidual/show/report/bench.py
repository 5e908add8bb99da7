"""Record of `make bench ARGS="--json runs/<run>/bench.json"`: how fast this code is on a machine.

The report shows the record that lies in its run. No verdict depends on it: a speed says as much about
the machine and its other work as about the code.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from minidual.durable import write_text
from minidual.errors import DataError
from minidual.gate.canonical import dumps

BENCH_FILE = "bench.json"
"""Name of the record in a run's folder."""
SCHEMA = 1


@dataclass(frozen=True)
class BenchRow:
    """One thing that was timed.

    Attributes:
        name: Unique in its table.
        numbers: By column; names end with their unit ("step_us"). Integers are counts.
        limits: Largest accepted number, by column.
    """

    name: str
    numbers: Mapping[str, int | float]
    limits: Mapping[str, float]

    @property
    def exceeded(self) -> tuple[str, ...]:
        """Columns over their limits; NaN is over every limit."""
        return tuple(
            column for column, limit in self.limits.items() if not self.numbers[column] <= limit
        )

    def text(self, column: str) -> str:
        """Return the number of a column as text; "-" if there is none."""
        number = self.numbers.get(column)
        if number is None:
            return "-"
        if isinstance(number, int):
            return str(number)
        return f"{number:.{_decimals(number)}f}"


def _decimals(number: float) -> int:
    if abs(number) < 10.0:
        return 2
    if abs(number) < 100.0:
        return 1
    return 0


@dataclass(frozen=True)
class BenchTable:
    """Measurements of one bench.

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


@dataclass(frozen=True)
class BenchRecord:
    """All tables of one call of the bench, in one process on one machine.

    Attributes:
        made_at: ISO time.
        commit: Commit of the code, with "+changes" if it was edited.
        machine: System, processor, cores, Python.
        libraries: Versions of the libraries that it compares.
        tables: By bench.
    """

    made_at: str
    commit: str
    machine: Mapping[str, str | int | float]
    libraries: Mapping[str, str]
    tables: Mapping[str, BenchTable]
    schema: int = SCHEMA


def write_bench(path: Path, record: BenchRecord) -> None:
    """Write a record as JSON."""
    write_text(path, dumps(asdict(record)))


def read_bench(path: Path) -> BenchRecord | None:
    """Return the record in a file; None if there is no file.

    Raises:
        DataError: It is damaged, or of another schema.
    """
    remedy = f'make bench ARGS="--json {path}", or delete the file'
    if not path.exists():
        return None
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
        record = TypeAdapter(BenchRecord).validate_python(content)
    except (OSError, ValueError, ValidationError, RecursionError) as error:
        raise DataError(f"{path} is not a record of the bench: {error}", remedy=remedy) from error
    if record.schema != SCHEMA:
        raise DataError(f"{path} has schema {record.schema}, not {SCHEMA}", remedy=remedy)
    return record
