"""What disturbances cost, in words: every sentence drawn from the table of methods by conditions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from minidual.report.captions import fault
from minidual.report.comparison import finite
from minidual.report.robustness import ConditionCell, ConditionTable
from minidual.report.trials import CLEAN
from minidual.report.wording import count, joined, stated

CERTAIN = 0.05
"""Two-sided probability below which trials are said to show a difference."""


def sentences(table: ConditionTable, comparisons: Sequence[Any]) -> Iterator[str]:
    """Yield what each method loses to which condition, then where the methods part.

    Args:
        table: Methods by conditions.
        comparisons: `data["comparisons"]` of the benchmark's verdict: pairs of methods on shared starts.
    """
    methods = [cell.method for cell in table.rows[0].cells] if table.rows else []
    for method in methods:
        cells = [c for c in table.cells if c.method == method and c.condition != CLEAN]
        yield from _costs(method, cells)
    yield from _partings(comparisons)


def _costs(method: str, cells: Sequence[ConditionCell]) -> Iterator[str]:
    met = [c for c in cells if c.state == "measured" and c.rate is not None]
    kept = [c for c in met if c.rate == 1.0]
    lost = sorted((c for c in met if c.rate != 1.0), key=lambda c: c.rate or 0.0)
    spared = [c.condition for c in cells if c.state == "spared"]
    if kept:
        yield stated(f"{method}: every trial passed under {joined([c.condition for c in kept])}")
    for cell in lost:
        yield stated(
            f"{method}: {cell.condition} left {cell.successes} of {cell.trials}{_loss(cell)}{_first(cell)}"
        )
    if spared:
        yield stated(f"{method}: {joined(spared)} cannot touch it")


def _loss(cell: ConditionCell) -> str:
    loss = cell.loss
    if loss is None:
        return ""
    points = 100.0 * loss.difference
    if round(points) == 0:
        return ", as many as on the same starts undisturbed"
    shown = "the trials show it" if loss.p_value < CERTAIN else "these trials do not separate it from chance"
    return (
        f", {points:+.0f} points against the same {count(loss.starts_n, 'start')} undisturbed (95 % interval "
        f"{100 * loss.low:+.0f} to {100 * loss.high:+.0f}, exact McNemar p = {loss.p_value:.2g}): {shown}"
    )


def _first(cell: ConditionCell) -> str:
    if not cell.failures:
        return ""
    reason, times = cell.failures[0]
    return f"; {'mostly ' if len(cell.failures) > 1 else ''}{fault(reason)}, {count(times, 'time')}"


def _partings(comparisons: Sequence[Any]) -> Iterator[str]:
    """Say under which disturbances two methods differ by more than the number of trials can blur."""
    for row in comparisons:
        if not isinstance(row, Mapping) or row.get("condition") == CLEAN:
            continue
        p_value, difference = finite(row.get("p_value")), finite(row.get("rate_difference"))
        low, high = finite(row.get("rate_difference_low")), finite(row.get("rate_difference_high"))
        if p_value is None or difference is None or low is None or high is None or p_value >= CERTAIN:
            continue
        better, worse = (row["first"], row["second"]) if difference > 0 else (row["second"], row["first"])
        sign = 1.0 if difference > 0 else -1.0
        ends = sorted((100 * sign * low, 100 * sign * high))
        yield stated(
            f"under {row['condition']}, {better} succeeds more often than {worse} on the same starts, by "
            f"{100 * abs(difference):.0f} points (95 % interval {ends[0]:.0f} to {ends[1]:.0f}, exact McNemar p = {p_value:.2g})"
        )
