"""The table of methods by indicators, from the benchmark's verdict, with every missing cell named."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from minidual.errors import DataError
from minidual.show.report.indicators import INDICATORS, Indicator

CellState = Literal["measured", "undefined", "missing"]


@dataclass(frozen=True)
class Cell:
    """One method's value of one indicator.

    Attributes:
        indicator: What it measures.
        value: SI value; None unless measured.
        state: "undefined" is an honest blank (no trial completed, so there is no completion time), "missing"
            is a hole.
        excellent: On the good side of the excellent limit; None where that has no meaning.
        best: No other method that succeeded at all has a better value.
        middle: Median over trials where `value` is the largest, SI; `value` itself elsewhere.
        low: Lower end of its 95 % interval, SI; None without one.
        high: Upper end.
    """

    indicator: Indicator
    value: float | None
    state: CellState
    excellent: bool | None = None
    best: bool = False
    middle: float | None = None
    low: float | None = None
    high: float | None = None

    @property
    def has_interval(self) -> bool:
        """Whether it says how sure it is."""
        return None not in (self.middle, self.low, self.high)

    @property
    def spread(self) -> str:
        """The interval for people, the median before it where the value is another."""
        if self.middle is None or self.low is None or self.high is None:
            return ""
        interval = self.indicator.range(self.low, self.high)
        if self.indicator.middle == self.indicator.key:
            return interval
        return f"median {self.indicator.shown(self.middle)}; {interval}"


@dataclass(frozen=True)
class MethodRow:
    """One method: its cells in the order of INDICATORS, and its successes.

    Attributes:
        low: Lower end of the 95 % Wilson interval of the success rate; None if missing.
        high: Upper end.
        trials: Number of trials; None if missing.
        failures: Trials by reason of failure, most frequent first.
    """

    method: str
    cells: tuple[Cell, ...]
    low: float | None
    high: float | None
    trials: int | None
    failures: tuple[tuple[str, int], ...]

    def cell(self, key: str) -> Cell:
        """Return the cell of the indicator `key`."""
        return next(cell for cell in self.cells if cell.indicator.key == key)

    @property
    def competes(self) -> bool:
        """Whether its other indicators mean anything: who never lifts the rod never tilts it."""
        return (self.cell("success_rate").value or 0.0) > 0.0

    @property
    def successes(self) -> int | None:
        """Number of successful trials; None if it cannot be told."""
        rate = self.cell("success_rate").value
        return None if rate is None or self.trials is None else round(rate * self.trials)

    @property
    def has_interval(self) -> bool:
        """Whether success has its interval and its number of trials."""
        return None not in (self.low, self.high, self.trials)


@dataclass(frozen=True)
class Comparison:
    """All methods that were asked for, in the order asked for."""

    rows: tuple[MethodRow, ...]

    def missing(self) -> list[str]:
        """Return "method.indicator" for every hole, "method.success_interval" and the like without an interval."""
        holes = [
            f"{row.method}.{cell.indicator.key}" for row in self.rows for cell in row.cells if cell.state == "missing"
        ]
        holes += [
            f"{row.method}.{cell.indicator.key}_interval"
            for row in self.rows
            for cell in row.cells[1:]
            if cell.state == "measured" and not cell.has_interval
        ]
        return holes + [f"{row.method}.success_interval" for row in self.rows if not row.has_interval]

    @property
    def complete(self) -> bool:
        """Whether there is a method and no hole."""
        return bool(self.rows) and not self.missing()


def finite(value: Any) -> float | None:
    """Return `value` as a float if it is a finite number, else None (bools and words are no numbers)."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None


def compare(methods: Sequence[str], data: Mapping[str, Any]) -> Comparison:
    """Return the comparison of `methods` from the benchmark's data.

    Args:
        methods: Methods that must be there.
        data: `data` of the benchmark's verdict; its entry "methods" holds one mapping a method.

    Raises:
        DataError: "methods" is no mapping of mappings.
    """
    table = data.get("methods", {})
    if not isinstance(table, Mapping) or not all(isinstance(row, Mapping) for row in table.values()):
        raise DataError("the benchmark's data has no table 'methods': a mapping of methods to their numbers")
    rows = [_row(method, table.get(method, {})) for method in methods]
    best = {
        indicator.key: _best(indicator, [row.cell(indicator.key).value for row in rows if row.competes])
        for indicator in INDICATORS
    }
    return Comparison(tuple(_mark(row, best) for row in rows))


def _row(method: str, record: Mapping[str, Any]) -> MethodRow:
    rate = finite(record.get("success_rate"))
    cells: list[Cell] = []
    for indicator in INDICATORS:
        value = finite(record.get(indicator.key))
        if value is not None:
            judged = rate != 0.0 or indicator.key == "success_rate"
            middle, low, high = (finite(record.get(name)) for name in (indicator.middle, indicator.low, indicator.high))
            excellent = indicator.is_excellent(value) if judged else None
            cells.append(Cell(indicator, value, "measured", excellent, False, middle, low, high))
        else:
            undefined = indicator.needs_success and rate == 0.0
            cells.append(Cell(indicator, None, "undefined" if undefined else "missing"))
    trials = finite(record.get("trials"))
    failures = record.get("failures", {})
    counts = {str(name): int(count) for name, count in failures.items()} if isinstance(failures, Mapping) else {}
    return MethodRow(
        method=method,
        cells=tuple(cells),
        low=finite(record.get("success_low")),
        high=finite(record.get("success_high")),
        trials=None if trials is None else int(trials),
        failures=tuple(sorted(counts.items(), key=lambda item: (-item[1], item[0]))),
    )


def _best(indicator: Indicator, values: Sequence[float | None]) -> float | None:
    measured = [value for value in values if value is not None]
    if len(measured) < 2:
        return None
    return min(measured) if indicator.better == "less" else max(measured)


def _mark(row: MethodRow, best: Mapping[str, float | None]) -> MethodRow:
    cells = tuple(
        replace(cell, best=row.competes and cell.value is not None and cell.value == best[cell.indicator.key])
        for cell in row.cells
    )
    return replace(row, cells=cells)
