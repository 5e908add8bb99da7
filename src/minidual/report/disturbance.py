"""What disturbances cost, in words: every sentence drawn from the table of methods by conditions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from minidual.report.captions import fault
from minidual.report.comparison import finite
from minidual.report.robustness import ConditionCell, ConditionTable
from minidual.report.trials import CLEAN
from minidual.report.wording import count, joined, points, stated

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
    shown = sorted((c for c in met if _shown(c)), key=lambda c: c.rate or 0.0)
    kept = [c for c in met if c not in shown and c.rate == 1.0]
    blurred = [c for c in met if c not in shown and c not in kept]
    spared = [c.condition for c in cells if c.state == "spared"]
    for cell in shown:
        yield stated(f"{method}: {cell.condition} left {_counted(cell)}{_loss(cell)}{_first(cell)}")
    if blurred:
        listed = joined([f"{_counted(c)} under {c.condition}" for c in blurred])
        yield stated(f"{method}: {listed}, which these trials do not tell from undisturbed")
    if kept:
        yield stated(f"{method}: every trial passed under {joined([c.condition for c in kept])}")
    if spared:
        yield stated(f"{method}: {joined(spared)} cannot touch it")


def _shown(cell: ConditionCell) -> bool:
    """Return whether the trials show that the condition changes its success."""
    return cell.loss is not None and cell.loss.p_value < CERTAIN


def _counted(cell: ConditionCell) -> str:
    return f"{cell.successes} of {cell.trials}"


def _loss(cell: ConditionCell) -> str:
    loss = cell.loss
    if loss is None:
        return ""
    return (
        f", {points(loss.difference)} points against the same {count(loss.starts_n, 'start')} undisturbed (95 % "
        f"interval {points(loss.low)} to {points(loss.high)}, exact McNemar p = {loss.p_value:.2g})"
    )


def _first(cell: ConditionCell) -> str:
    """Say what failed first, and whether the method refused rather than failed."""
    parts = []
    if cell.failures:
        reason, times = cell.failures[0]
        parts.append(f"; {fault(reason)} {count(times, 'time')}")
    if cell.stopped:
        parts.append(f"; it stopped itself in {count(cell.stopped, 'trial')}")
    return "".join(parts)


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
        ends = sorted((sign * low, sign * high))
        yield stated(
            f"Under {row['condition']}, {better} succeeds more often than {worse} on the same starts, by "
            f"{100 * abs(difference):.0f} points (95 % interval {points(ends[0])} to {points(ends[1])}, exact McNemar p = {p_value:.2g})"
        )
