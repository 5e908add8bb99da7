"""The table of methods by conditions, from the benchmark's verdict, with every missing cell named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from minidual.errors import DataError
from minidual.show.report.comparison import finite
from minidual.show.report.indicators import INDICATORS, Indicator
from minidual.show.report.trials import CLEAN

State = Literal["measured", "spared", "missing"]


@dataclass(frozen=True)
class Measure:
    """Median over trials and its 95 % bootstrap interval, SI."""

    middle: float
    low: float
    high: float


@dataclass(frozen=True)
class Loss:
    """Success under a condition less that of the same starts undisturbed: negative where it costs something.

    Attributes:
        difference: Of the two rates.
        low: Lower end of its 95 % interval.
        high: Upper end.
        p_value: Exact McNemar.
        starts_n: Shared starts.
        p_holm: The same, corrected for the number of losses that are tested (Holm).
    """

    difference: float
    low: float
    high: float
    p_value: float
    starts_n: int
    p_holm: float


@dataclass(frozen=True)
class ConditionCell:
    """One method under one condition.

    Attributes:
        state: "spared" is an honest blank: the condition cannot touch the method. "missing" is a hole.
        why: Why it is spared, or an empty string.
        rate: Success rate; None unless measured.
        low: Lower end of its 95 % Wilson interval.
        high: Upper end.
        trials: Number of trials.
        measures: By key of the other indicators; None where no trial completed.
        loss: Against the undisturbed trials; None for those themselves.
        failures: Trials by reason of failure, most frequent first.
        stopped: Failed trials in which the method stopped itself.
        holes: Names of what should be there and is not.
    """

    method: str
    condition: str
    state: State
    why: str = ""
    rate: float | None = None
    low: float | None = None
    high: float | None = None
    trials: int | None = None
    measures: Mapping[str, Measure | None] = field(default_factory=dict)
    loss: Loss | None = None
    failures: tuple[tuple[str, int], ...] = ()
    stopped: int = 0
    holes: tuple[str, ...] = ()

    @property
    def successes(self) -> int | None:
        """Number of successful trials; None if it cannot be told."""
        return None if self.rate is None or self.trials is None else round(self.rate * self.trials)


@dataclass(frozen=True)
class ConditionRow:
    """One condition: what it does, and a cell for each method."""

    condition: str
    summary: str
    cells: tuple[ConditionCell, ...]


@dataclass(frozen=True)
class ConditionTable:
    """All conditions that were asked for, the undisturbed one first; empty where nothing disturbs."""

    rows: tuple[ConditionRow, ...] = ()

    @property
    def cells(self) -> list[ConditionCell]:
        """Every cell, row by row."""
        return [cell for row in self.rows for cell in row.cells]

    def missing(self) -> list[str]:
        """Return "method.condition.number" for every hole in the disturbed rows; the first stands in the comparison."""
        return [
            f"{cell.method}.{cell.condition}.{hole}"
            for cell in self.cells
            if cell.condition != CLEAN
            for hole in cell.holes
        ]


def tabulate(methods: Sequence[str], conditions: Sequence[str], data: Mapping[str, Any]) -> ConditionTable:
    """Return the table of `methods` by `conditions` from the benchmark's data.

    Args:
        methods: Methods that must be there.
        conditions: Conditions that must be there, `clean` among them.
        data: `data` of the benchmark's verdict: "methods", "conditions", "losses".

    Raises:
        DataError: One of these is of another shape.
    """
    disturbed = [name for name in conditions if name != CLEAN]
    if not disturbed:
        return ConditionTable()
    table = _mapping(data.get("conditions", {}), "conditions")
    losses = _losses(data.get("losses", []))
    clean = _mapping(data.get("methods", {}), "methods")
    rows = [ConditionRow(CLEAN, "nothing disturbs the trial", tuple(_cell(m, CLEAN, clean, None) for m in methods))]
    for name in disturbed:
        entry = _mapping(table.get(name, {}), f"conditions.{name}")
        records = _mapping(entry.get("methods", {}), f"conditions.{name}.methods")
        cells = tuple(_cell(m, name, records, losses.get((m, name))) for m in methods)
        rows.append(ConditionRow(name, str(entry.get("summary", "")), cells))
    return ConditionTable(tuple(rows))


def _mapping(value: Any, name: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise DataError(f"the benchmark's data has no table '{name}': a mapping")
    return value


def _losses(rows: Any) -> dict[tuple[str, str], Loss]:
    if not isinstance(rows, Sequence) or not all(isinstance(row, Mapping) for row in rows):
        raise DataError("the benchmark's data has no list 'losses' of mappings")
    from minidual.trials.statistics import holm

    found: dict[tuple[str, str], Loss] = {}
    for row in rows:
        names = ("rate_difference", "rate_difference_low", "rate_difference_high", "p_value", "trials_n")
        numbers = [finite(row.get(name)) for name in names]
        if row.get("second") == CLEAN and all(number is not None for number in numbers):
            difference, low, high, p_value, n = (float(number or 0.0) for number in numbers)
            found[str(row.get("method")), str(row.get("first"))] = Loss(difference, low, high, p_value, int(n), p_value)
    corrected = holm([loss.p_value for loss in found.values()])
    return {key: replace(loss, p_holm=p) for (key, loss), p in zip(found.items(), corrected, strict=True)}


def _cell(method: str, condition: str, records: Mapping[str, Any], loss: Loss | None) -> ConditionCell:
    record = _mapping(records.get(method, {}), f"{condition}: {method}")
    if record.get("applies") is False and record.get("why"):
        return ConditionCell(method, condition, "spared", why=str(record["why"]))
    rate, low, high, trials = (
        finite(record.get(name)) for name in ("success_rate", "success_low", "success_high", "trials")
    )
    holes = [
        name
        for name, value in (("success_rate", rate), ("success_low", low), ("success_high", high), ("trials", trials))
        if value is None
    ]
    measures: dict[str, Measure | None] = {}
    for indicator in INDICATORS[1:]:
        measures[indicator.key] = _measure(indicator, record)
        if measures[indicator.key] is None and not (indicator.needs_success and rate == 0.0):
            holes.append(indicator.key)
    if loss is None and condition != CLEAN:
        holes.append("loss")
    failures = record.get("failures", {})
    counts = {str(k): int(n) for k, n in failures.items()} if isinstance(failures, Mapping) else {}
    return ConditionCell(
        method,
        condition,
        "missing" if rate is None or trials is None else "measured",
        rate=rate,
        low=low,
        high=high,
        trials=None if trials is None else int(trials),
        measures=measures,
        loss=loss,
        failures=tuple(sorted(counts.items(), key=lambda item: (-item[1], item[0]))),
        stopped=int(finite(record.get("stopped_n")) or 0),
        holes=tuple(holes),
    )


def _measure(indicator: Indicator, record: Mapping[str, Any]) -> Measure | None:
    middle, low, high = (finite(record.get(name)) for name in (indicator.middle, indicator.low, indicator.high))
    return None if middle is None or low is None or high is None else Measure(middle, low, high)
