"""Indicators that compare methods, and the table of methods by conditions; missing numbers are listed."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from minidual.registry import rows_beside
from minidual.show.report.wording import percent
from minidual.trials.conditions import CLEAN
from minidual.trials.measures import MEASURES
from minidual.trials.statistics import holm

_UNSEEN = 0.0005  # smaller displayed values are rounding error


class Indicator(NamedTuple):
    """One column of the comparison (tables.yaml).

    Attributes:
        key: Key in the benchmark's data.
        scale: Displayed value / SI value.
        excellent: Limit, SI.
        spread: Keys of middle and 95 % interval.
        meaning, over: What one trial gives, and how the trials become the compared number.
        needs_success: Undefined without a success.
    """

    key: str
    column: str
    title: str
    unit: str
    spread: Sequence[str]
    meaning: str
    over: str
    scale: float = 1.0
    excellent: float | None = None
    needs_success: bool = False
    more_is_better: bool = False

    def shown(self, value: float) -> str:
        """Return `value` in the displayed unit."""
        if self.unit == "%":
            return percent(value).removesuffix(" %")
        seen = value * self.scale
        return "0.000" if 0.0 < abs(seen) < _UNSEEN else three_digits(seen)

    def is_excellent(self, value: float) -> bool:
        """Return whether `value` beats the excellent limit."""
        if self.excellent is None:
            return False
        return value > self.excellent if self.more_is_better else value < self.excellent

    @property
    def excellent_text(self) -> str:
        """The excellent limit as text."""
        if self.excellent is None:
            return ""
        return f"{'>' if self.more_is_better else '<'} {self.excellent * self.scale:g} {self.unit}"


def three_digits(value: float) -> str:
    """Return three significant digits, without exponent from 0.0001 up."""
    if abs(value) >= 999.5:
        return f"{value:,.0f}"
    text = f"{value:#.3g}".removesuffix(".")
    return text if "e" not in text else f"{value:.1e}"


INDICATORS = tuple(Indicator(key, **row) for key, row in rows_beside(__file__).items())
SUCCESS = INDICATORS[0]

CERTAIN = 0.05
"""Two-sided significance level after Holm's correction."""

Pair = Mapping[str, Any]
"""A row of minidual.trials.benchmark with `p_holm` and `shown`: whether the difference is significant."""


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
        measures: By indicator key; None if missing or undefined.
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
        """Success rate with Wilson interval."""
        return self.measures.get(SUCCESS.key)

    @property
    def successes(self) -> int:
        """Number of successes."""
        return round((self.success.value if self.success else 0.0) * (self.trials or 0))

    @property
    def competes(self) -> bool:
        """Whether a trial succeeded; without one it is not ranked."""
        return self.success is not None and self.success.value > 0.0

    @property
    def holes(self) -> list[str]:
        """Names of missing numbers."""
        if self.state == "spared":
            return []
        holes = [
            i.key for i in INDICATORS if self.measures[i.key] is None and not self.undefined(i)
        ]
        holes += ["trials"] * (self.trials is None)
        return holes + ["loss"] * (self.loss is None and self.condition != CLEAN)

    def undefined(self, indicator: Indicator) -> bool:
        """Return whether `indicator` needs a success and there is none; not a hole."""
        return indicator.needs_success and self.success is not None and not self.competes

    def excellent(self, indicator: Indicator) -> bool:
        """Return whether the value beats the excellent limit."""
        measure = self.measures.get(indicator.key)
        judged = self.competes or indicator is SUCCESS
        return judged and measure is not None and indicator.is_excellent(measure.value)


class Row(NamedTuple):
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


class Tables(NamedTuple):
    """Methods by conditions of one task, the undisturbed row first.

    Attributes:
        pairs: Undisturbed.
        partings: Disturbed, with a significant difference.
        own: The run's own task, for which the excellent limits were set.
    """

    rows: tuple[Row, ...]
    pairs: Sequence[Pair] = ()
    partings: Sequence[Pair] = ()
    own: bool = True

    @property
    def clean(self) -> Row:
        """The undisturbed row."""
        return self.rows[0]

    @property
    def cells(self) -> Iterator[Cell]:
        """Every cell, row by row."""
        return (cell for row in self.rows for cell in row.cells)

    @property
    def losses(self) -> list[Pair]:
        """Significant effects of a disturbance."""
        return [cell.loss for cell in self.cells if cell.loss and cell.loss["shown"]]

    def missing(self) -> list[str]:
        """Return "method.condition.number" per hole."""
        holes = [
            f"{cell.method}.{cell.condition}.{hole}" for cell in self.cells for hole in cell.holes
        ]
        return holes if self.clean.cells else ["no method"]


def finite(value: Any) -> float | None:
    """Return a finite number as float, else None."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None


def corrected(rows: Sequence[Pair]) -> list[Pair]:
    """Return the rows of one family of tests after Holm's correction."""
    ps = holm([row["p_value"] for row in rows])
    return [{**row, "p_holm": p, "shown": p < CERTAIN} for row, p in zip(rows, ps, strict=True)]


def tabulate(
    methods: Sequence[str],
    conditions: Sequence[str],
    data: Mapping[str, Any],
    *,
    own: bool = True,
    limit: Callable[[str, str], str] = lambda _method, _condition: "",
) -> Tables:
    """Return the table of required `methods` and `conditions`; CLEAN is always included.

    `data`: see `benchmark_data`. `limit` says what is promised for a method under a condition.
    """
    records = {CLEAN: ("nothing disturbs the trial", data.get("methods", {}))}
    for name in (name for name in conditions if name != CLEAN):
        entry = data.get("conditions", {}).get(name, {})
        records[name] = entry.get("summary", ""), entry.get("methods", {})
    lost = {(pair["first"], pair["method"]): pair for pair in corrected(data.get("losses", []))}
    # Undisturbed pairs are their own Holm family: their result must not depend on which disturbances are run.
    pairs = data.get("comparisons", [])
    clean, disturbed = (
        corrected([p for p in pairs if (p["condition"] == CLEAN) is c]) for c in (True, False)
    )
    rows = (
        Row(
            name,
            summary,
            tuple(
                _cell(m, name, mine.get(m, {}), lost.get((name, m)), limit(m, name))
                for m in methods
            ),
        )
        for name, (summary, mine) in records.items()
    )
    return Tables(tuple(rows), clean, [pair for pair in disturbed if pair["shown"]], own)


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
    failures = record.get("failures", {})
    return Cell(
        method,
        condition,
        "missing" if trials is None or _measure(SUCCESS, record) is None else "measured",
        trials=None if trials is None else int(trials),
        measures={indicator.key: _measure(indicator, record) for indicator in INDICATORS},
        loss=loss,
        failures=tuple(sorted(failures.items(), key=lambda item: (-item[1], item[0]))),
        stopped=record.get("stopped_n", 0),
        further={name: finite(record.get("measures", {}).get(name)) for name in MEASURES},
        limit=limit,
    )


def _measure(indicator: Indicator, record: Mapping[str, Any]) -> IndicatorValue | None:
    found = [
        number
        for name in (indicator.key, *indicator.spread)
        if (number := finite(record.get(name))) is not None
    ]
    return IndicatorValue(*found) if len(found) == 4 else None
