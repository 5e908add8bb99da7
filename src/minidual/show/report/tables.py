"""The table of methods by conditions; numbers that are missing are listed."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from minidual.show.report.indicators import INDICATORS, SUCCESS, Indicator
from minidual.trials.conditions import CLEAN
from minidual.trials.measures import MEASURES
from minidual.trials.statistics import holm

CERTAIN = 0.05
"""Two-sided significance level after Holm's correction."""

Pair = Mapping[str, Any]
"""A row of minidual.trials.benchmark with `p_holm`, and `shown`: whether it is significant."""

Limit = Callable[[str, str], str]
"""Returns the promised limit of a method under a condition, as text; "" for none."""


@dataclass(frozen=True)
class IndicatorValue:
    """One indicator of a cell, SI.

    Attributes:
        value: Compared number: `middle`, or a maximum over trials.
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
        state: "spared": does not apply; "missing": no success rate.
        why: Why it does not apply.
        trials: Number of trials.
        measures: By indicator key; None if missing or undefined.
        loss: Comparison with the same starts undisturbed.
        failures: (reason, trials), most frequent first.
        stopped: Failed trials that the method itself stopped.
        further: Values of MEASURES; None where one does not apply.
        limit: What is promised; empty: nothing.
    """

    method: str
    condition: str
    state: Literal["measured", "spared", "missing"]
    why: str = ""
    trials: int | None = None
    measures: Mapping[str, IndicatorValue | None] = field(default_factory=dict)
    loss: Pair | None = None
    failures: tuple[tuple[str, int], ...] = ()
    stopped: int = 0
    further: Mapping[str, float | None] = field(default_factory=dict)
    limit: str = ""

    @property
    def success(self) -> IndicatorValue | None:
        """Success rate with its Wilson interval."""
        return self.measures.get(SUCCESS.key)

    @property
    def successes(self) -> int:
        """Number of successes."""
        if self.success is None or self.trials is None:
            return 0
        return round(self.success.value * self.trials)

    @property
    def competes(self) -> bool:
        """Whether a trial succeeded; without one the method is not ranked."""
        return self.success is not None and self.success.value > 0.0

    @property
    def holes(self) -> list[str]:
        """Names of missing numbers."""
        if self.state == "spared":
            return []
        holes = [
            indicator.key
            for indicator in INDICATORS
            if self.measures[indicator.key] is None and not self.undefined(indicator)
        ]
        if self.trials is None:
            holes.append("trials")
        if self.loss is None and self.condition != CLEAN:
            holes.append("loss")
        return holes

    def undefined(self, indicator: Indicator) -> bool:
        """Return whether `indicator` needs a success and there is none; this is not a hole."""
        return indicator.needs_success and self.success is not None and not self.competes

    def excellent(self, indicator: Indicator) -> bool:
        """Return whether the value beats the limit of "excellent"."""
        measure = self.measures.get(indicator.key)
        judged = self.competes or indicator is SUCCESS
        return judged and measure is not None and indicator.is_excellent(measure.value)


class Row(NamedTuple):
    """One condition with a cell per method."""

    condition: str
    summary: str
    cells: tuple[Cell, ...]

    def is_best(self, cell: Cell, indicator: Indicator) -> bool:
        """Return whether no competitor is better; False if there is only one value."""
        measure = cell.measures.get(indicator.key)
        if measure is None or not cell.competes:
            return False
        competitors = (other.measures.get(indicator.key) for other in self.cells if other.competes)
        values = [other.value for other in competitors if other is not None]
        if len(values) < 2:
            return False
        best = max(values) if indicator.more_is_better else min(values)
        return measure.value == best


class Tables(NamedTuple):
    """Methods by conditions of one task, the undisturbed row first.

    Attributes:
        rows: One per condition.
        pairs: Comparisons of methods, undisturbed.
        disturbed_pairs: Comparisons of methods under disturbances.
        own: Whether it is the run's own task, for which the limits of "excellent" were set.
    """

    rows: tuple[Row, ...]
    pairs: Sequence[Pair] = ()
    disturbed_pairs: Sequence[Pair] = ()
    own: bool = True

    @property
    def clean(self) -> Row:
        """The undisturbed row."""
        return self.rows[0]

    def measured(self, name: str) -> bool:
        """Return whether any method has a further measure, undisturbed."""
        return any(cell.further.get(name) is not None for cell in self.clean.cells)

    @property
    def most_tried(self) -> Row:
        """The row with most trials; of equals the first."""
        return max(self.rows, key=lambda row: max((c.trials or 0 for c in row.cells), default=0))

    @property
    def summary_rows(self) -> list[Row]:
        """The undisturbed row, and the disturbed one with more trials than it."""
        return [self.clean] if self.most_tried is self.clean else [self.clean, self.most_tried]

    @property
    def shown_pairs(self) -> list[Pair]:
        """Comparisons of methods in the summary rows."""
        most_tried = self.most_tried.condition
        of_it = [pair for pair in self.disturbed_pairs if pair["condition"] == most_tried]
        return [*self.pairs, *of_it]

    @property
    def partings(self) -> list[Pair]:
        """Significant comparisons of methods under a disturbance."""
        return [pair for pair in self.disturbed_pairs if pair["shown"]]

    @property
    def cells(self) -> Iterator[Cell]:
        """Every cell, row by row."""
        return (cell for row in self.rows for cell in row.cells)

    @property
    def losses(self) -> list[Pair]:
        """Significant effects of a disturbance."""
        return [cell.loss for cell in self.cells if cell.loss is not None and cell.loss["shown"]]

    def missing(self) -> list[str]:
        """Return "method.condition.number" per hole."""
        if not self.clean.cells:
            return ["no method"]
        return [
            f"{cell.method}.{cell.condition}.{hole}" for cell in self.cells for hole in cell.holes
        ]


def finite(value: Any) -> float | None:
    """Return a finite number as float, else None."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    if not math.isfinite(value):
        return None
    return float(value)


def corrected(rows: Sequence[Pair]) -> list[Pair]:
    """Return the rows of one family of tests after Holm's correction."""
    p_values = holm([row["p_value"] for row in rows])
    return [
        {**row, "p_holm": p, "shown": p < CERTAIN} for row, p in zip(rows, p_values, strict=True)
    ]


def _promises_nothing(_method: str, _condition: str) -> str:
    return ""


def tabulate(
    methods: Sequence[str],
    conditions: Sequence[str],
    data: Mapping[str, Any],
    *,
    own: bool = True,
    limit: Limit = _promises_nothing,
) -> Tables:
    """Return the table of the required methods and conditions; CLEAN is always included.

    Args:
        methods: Columns.
        conditions: Rows.
        data: One task of the benchmark's data; see `benchmark_data`.
        own: Whether it is the run's own task.
        limit: Promises.
    """
    losses = {(row["first"], row["method"]): row for row in corrected(data.get("losses", []))}

    def row_of(condition: str, summary: str, records: Mapping[str, Any]) -> Row:
        cells = [
            _cell(
                method,
                condition,
                records.get(method, {}),
                losses.get((condition, method)),
                limit(method, condition),
            )
            for method in methods
        ]
        return Row(condition, summary, tuple(cells))

    rows = [row_of(CLEAN, "nothing disturbs the trial", data.get("methods", {}))]
    for condition in conditions:
        if condition == CLEAN:
            continue
        entry = data.get("conditions", {}).get(condition, {})
        rows.append(row_of(condition, entry.get("summary", ""), entry.get("methods", {})))
    # Undisturbed pairs are a Holm family of their own: their result must not depend on which
    # disturbances are run.
    pairs = data.get("comparisons", [])
    clean_pairs = corrected([pair for pair in pairs if pair["condition"] == CLEAN])
    disturbed_pairs = corrected([pair for pair in pairs if pair["condition"] != CLEAN])
    return Tables(tuple(rows), clean_pairs, disturbed_pairs, own)


def _cell(
    method: str,
    condition: str,
    record: Mapping[str, Any],
    loss: Pair | None,
    limit: str,
) -> Cell:
    if record.get("applies") is False and record.get("why"):
        return Cell(method, condition, "spared", why=record["why"])
    trials = finite(record.get("trials"))
    measured = trials is not None and _measure(SUCCESS, record) is not None
    failures = record.get("failures", {})
    further = record.get("measures", {})
    return Cell(
        method,
        condition,
        "measured" if measured else "missing",
        trials=None if trials is None else int(trials),
        measures={indicator.key: _measure(indicator, record) for indicator in INDICATORS},
        loss=loss,
        failures=tuple(sorted(failures.items(), key=_most_frequent_first)),
        stopped=record.get("stopped_n", 0),
        further={name: finite(further.get(name)) for name in MEASURES},
        limit=limit,
    )


def _most_frequent_first(failure: tuple[str, int]) -> tuple[int, str]:
    reason, trials = failure
    return -trials, reason


def _measure(indicator: Indicator, record: Mapping[str, Any]) -> IndicatorValue | None:
    """Return one indicator of a record; None unless value, middle and interval are finite."""
    numbers: list[float] = []
    for name in (indicator.key, *indicator.spread):
        number = finite(record.get(name))
        if number is None:
            return None
        numbers.append(number)
    return IndicatorValue(*numbers)
