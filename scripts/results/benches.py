"""The blocks `step` and `planning`, from records of `make bench ARGS="... --json FILE"`."""

import re
from collections.abc import Mapping
from pathlib import Path

from minidual.show.report.bench import BenchRecord, BenchRow, BenchTable, read_bench
from minidual.tasks.catalogue import TASKS
from scripts.results.markdown import origin, origin_line, table

STEP_BLOCK = "step"
PLANNING_BLOCK = "planning"
STEP_COMMAND = "make bench ARGS=carry"
PLANNING_COMMAND = "make bench ARGS=--peers"
_STEP_COLUMNS = re.compile(r"ratio|^(median|mean|p99)_us$")
_OWN = "minidual"
"""How the names of the own planners begin."""
_SOLVED = "solved"
_TIME = "median_ms"
_FAULTS = ("colliding", "over_jerk")


def step_block(path: Path) -> str | None:
    """Return the cost of a whole step of each task; None without a record of the bench `carry`."""
    found = _read(path, "carry")
    if found is None:
        return None
    record, bench = found
    columns = [name for name in bench.columns if _STEP_COLUMNS.search(name)]
    rows: list[list[str]] = []
    for row in bench.rows:
        task, _, method = row.name.partition(", ")
        if task in TASKS and "," not in method:
            numbers = [row.text(column) for column in columns]
            rows.append([f"`{task}`, `{method}`", *numbers])
    return f"{_line(record, STEP_COMMAND)}\n\n{table(['', *columns], rows)}"


def planning_block(path: Path) -> str | None:
    """Return solved queries of every planner; None without a record of them with peers."""
    found = _read(path, "hard")
    if found is None:
        return None
    record, bench = found
    sets = [row for row in bench.rows if ": " not in row.name]
    planners = list(dict.fromkeys(_planner(row) for row in bench.rows if ": " in row.name))
    if all(name.startswith(_OWN) for name in planners):
        return None
    by_name = {row.name: row for row in bench.rows}
    rows: list[list[str]] = []
    for drawn in sets:
        rows.append([drawn.name, _plannable(drawn.numbers)])
        rows[-1] += [_solved(by_name.get(f"{drawn.name}: {name}")) for name in planners]
    faults = [_faults(name, bench) for name in planners]
    header = ["set", "can be solved", *(f"{name}: solved, {_TIME}" for name in planners)]
    return (
        f"{_line(record, PLANNING_COMMAND)}\n\n{table(header, rows)}\n\n"
        f"{bench.title}. Paths with a fault: {'; '.join(faults)}."
    )


def _read(path: Path, bench: str) -> tuple[BenchRecord, BenchTable] | None:
    record = read_bench(path)
    if record is None or bench not in record.tables:
        return None
    return record, record.tables[bench]


def _line(record: BenchRecord, command: str) -> str:
    return origin_line([origin(record.commit, record.machine, record.made_at)], command)


def _planner(row: BenchRow) -> str:
    return row.name.partition(": ")[2]


def _plannable(numbers: Mapping[str, int | float]) -> str:
    return str(numbers["drawn"] - numbers["infeasible"] - numbers["no_posture"])


def _solved(row: BenchRow | None) -> str:
    if row is None:
        return ""
    return f"{row.text(_SOLVED)}, {row.text(_TIME)}"


def _faults(planner: str, bench: BenchTable) -> str:
    """Return how many paths of a planner have each fault, over all sets."""
    rows = [row for row in bench.rows if _planner(row) == planner]
    counts = [f"{sum(row.numbers[fault] for row in rows)} {fault}" for fault in _FAULTS]
    solved_n = sum(row.numbers[_SOLVED] for row in rows)
    return f"{planner} {', '.join(counts)} of {solved_n}"
