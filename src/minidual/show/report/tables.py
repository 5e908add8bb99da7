"""Table of methods by conditions; missing numbers are listed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from minidual.errors import DataError
from minidual.show.report.indicators import INDICATORS, SUCCESS, Indicator
from minidual.show.report.paired import Paired, corrected, read_paired
from minidual.trials.conditions import CLEAN


@dataclass(frozen=True)
class Measure:
    """One indicator of a cell, SI.

    Attributes:
        value: Compared number; sometimes the maximum over trials.
        middle: Median or rate, with 95 % interval `low` to `high`.
    """

    value: float
    middle: float
    low: float
    high: float


@dataclass(frozen=True)
class Cell:
    """One method under one condition.

    Attributes:
        state: "spared": not applicable; "missing": incomplete success data.
        measures: By indicator key; None if missing or undefined.
        loss: Comparison with the undisturbed starts.
        failures: (reason, trials), most frequent first.
        stopped: Failed trials that the method itself stopped.
        holes: Missing numbers.
    """

    method: str
    condition: str
    state: Literal["measured", "spared", "missing"]
    why: str = ""
    trials: int | None = None
    measures: Mapping[str, Measure | None] = field(default_factory=dict)
    loss: Paired | None = None
    failures: tuple[tuple[str, int], ...] = ()
    stopped: int = 0
    holes: tuple[str, ...] = ()

    @property
    def success(self) -> Measure | None:
        """Success rate with Wilson interval."""
        return self.measures.get(SUCCESS.key)

    @property
    def successes(self) -> int:
        """Number of successes."""
        return round((self.success.value if self.success else 0.0) * (self.trials or 0))

    @property
    def competes(self) -> bool:
        """Whether any trial succeeded. Others are not ranked: an object never lifted never tilts."""
        return self.success is not None and self.success.value > 0.0

    def undefined(self, indicator: Indicator) -> bool:
        """Return whether it lacks the success it needs; not a hole."""
        return indicator.needs_success and self.success is not None and not self.competes

    def excellent(self, indicator: Indicator) -> bool:
        """Return whether the value beats the excellent limit."""
        measure = self.measures.get(indicator.key)
        judged = self.competes or indicator is SUCCESS
        return judged and measure is not None and indicator.is_excellent(measure.value)


@dataclass(frozen=True)
class Row:
    """One condition with a cell per method."""

    condition: str
    summary: str
    cells: tuple[Cell, ...]

    def is_best(self, cell: Cell, indicator: Indicator) -> bool:
        """Return whether no competitor is better; False with one value."""
        found = [m.value for c in self.cells if c.competes and (m := c.measures.get(indicator.key))]
        mine = cell.measures.get(indicator.key)
        if len(found) < 2 or mine is None or not cell.competes:
            return False
        return mine.value == (max if indicator.more_is_better else min)(found)


@dataclass(frozen=True)
class Tables:
    """Methods by conditions, the undisturbed row first."""

    rows: tuple[Row, ...]

    @property
    def clean(self) -> Row:
        """The undisturbed row."""
        return self.rows[0]

    @property
    def cells(self) -> Iterator[Cell]:
        """Every cell, row by row."""
        return (cell for row in self.rows for cell in row.cells)

    def missing(self) -> list[str]:
        """Return "method.condition.number" per hole."""
        return [f"{cell.method}.{cell.condition}.{hole}" for cell in self.cells for hole in cell.holes]


def finite(value: Any) -> float | None:
    """Return a finite number as float, else None."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None


def tabulate(methods: Sequence[str], conditions: Sequence[str], data: Mapping[str, Any]) -> Tables:
    """Return the table of required `methods` and `conditions`; CLEAN is always included.

    Raises:
        DataError: `data` of the benchmark's verdict is malformed.
    """
    clean = _mapping(data.get("methods", {}), "methods")
    rows = [Row(CLEAN, "nothing disturbs the trial", tuple(_cell(m, CLEAN, clean, None) for m in methods))]
    disturbed = _mapping(data.get("conditions", {}), "conditions")
    pairs = corrected(read_paired(data.get("losses", []), "losses", "method"))
    losses = {(loss.family, loss.first): loss for loss in pairs if loss.second == CLEAN}
    for name in conditions:
        if name == CLEAN:
            continue
        entry = _mapping(disturbed.get(name, {}), f"conditions.{name}")
        records = _mapping(entry.get("methods", {}), f"conditions.{name}.methods")
        cells = tuple(_cell(m, name, records, losses.get((m, name))) for m in methods)
        rows.append(Row(name, str(entry.get("summary", "")), cells))
    return Tables(tuple(rows))


def _mapping(value: Any, name: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise DataError(f"the benchmark's data has no table '{name}': it must be a mapping")
    return value


def _cell(method: str, condition: str, records: Mapping[str, Any], loss: Paired | None) -> Cell:
    record = _mapping(records.get(method, {}), f"methods.{method}" if condition == CLEAN else f"{condition}.{method}")
    if record.get("applies") is False and record.get("why"):
        return Cell(method, condition, "spared", why=str(record["why"]))
    trials = finite(record.get("trials"))
    failures = _mapping(record.get("failures", {}), f"{method}.failures")
    cell = Cell(
        method,
        condition,
        "missing" if trials is None or _measure(SUCCESS, record) is None else "measured",
        trials=None if trials is None else int(trials),
        measures={indicator.key: _measure(indicator, record) for indicator in INDICATORS},
        loss=loss,
        failures=tuple(sorted(((str(k), int(n)) for k, n in failures.items()), key=lambda item: (-item[1], item[0]))),
        stopped=int(finite(record.get("stopped_n")) or 0),
    )
    holes = [i.key for i in INDICATORS if cell.measures[i.key] is None and not cell.undefined(i)]
    holes += ["trials"] * (trials is None) + ["loss"] * (loss is None and condition != CLEAN)
    return replace(cell, holes=tuple(holes))


def _measure(indicator: Indicator, record: Mapping[str, Any]) -> Measure | None:
    found = [number for name in (indicator.key, *indicator.spread) if (number := finite(record.get(name))) is not None]
    return Measure(*found) if len(found) == 4 else None
