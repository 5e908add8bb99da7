"""What disturbances cost, in words: every sentence drawn from the table of methods by conditions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from minidual.errors import DataError
from minidual.show.report.captions import fault
from minidual.show.report.comparison import finite
from minidual.show.report.robustness import ConditionCell, ConditionTable
from minidual.show.report.trials import CLEAN
from minidual.show.report.wording import count, joined, points, stated

CERTAIN = 0.05
"""Two-sided probability below which trials are said to show a difference, after Holm's correction within its family: all
losses are one, pairs of methods undisturbed a second, disturbed a third."""


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
    blurred = [c for c in met if c not in shown and c not in kept and c.loss is not None]
    unknown = [c for c in met if c not in kept and c.loss is None]
    spared = [c.condition for c in cells if c.state == "spared"]
    for cell in shown:
        yield stated(f"{method}: {cell.condition} left {_counted(cell)}{_loss(cell)}{_first(cell)}")
    if blurred:
        listed = joined([f"{_counted(c)} under {c.condition}" for c in blurred])
        yield stated(f"{method}: {listed}, which these trials do not tell from undisturbed")
    if unknown:
        listed = joined([f"{_counted(c)} under {c.condition}" for c in unknown])
        yield stated(f"{method}: {listed}, without a comparison with the undisturbed trials")
    if kept:
        yield stated(f"{method}: every trial passed under {joined([c.condition for c in kept])}")
    if spared:
        yield stated(f"{method}: {joined(spared)} cannot touch it")


def _shown(cell: ConditionCell) -> bool:
    """Return whether the trials show that the condition changes its success."""
    return cell.loss is not None and cell.loss.p_holm < CERTAIN


def _counted(cell: ConditionCell) -> str:
    return f"{cell.successes} of {cell.trials}"


def _loss(cell: ConditionCell) -> str:
    loss = cell.loss
    if loss is None:
        return ""
    return (
        f", {points(loss.difference)} points against the same {count(loss.starts_n, 'start')} undisturbed (95 % "
        f"interval {points(loss.low)} to {points(loss.high)}, exact McNemar p = {loss.p_value:.2g}, "
        f"{loss.p_holm:.2g} corrected for the number of losses)"
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


def corrected_pairs(comparisons: Sequence[Any], *, disturbed: bool) -> dict[tuple[str, frozenset[str]], float]:
    """Return {(condition, the two methods): probability after Holm's correction} over the pairs of one family.

    Undisturbed pairs are a family of their own: what they show does not depend on which disturbances are run beside.

    Raises:
        DataError: A row that does not name its two methods, or a number that is no probability.
    """
    from minidual.trials.statistics import holm

    found: dict[tuple[str, frozenset[str]], float] = {}
    for row in comparisons:
        if not isinstance(row, Mapping) or (row.get("condition") != CLEAN) != disturbed:
            continue
        p_value = finite(row.get("p_value"))
        if p_value is None:
            continue
        if not 0.0 <= p_value <= 1.0:
            raise DataError(f"the benchmark's data has a comparison whose p_value is {p_value:g}: 0 to 1")
        found[str(row.get("condition")), frozenset(_pair(row))] = p_value
    return dict(zip(found, holm(list(found.values())), strict=True))


def _pair(row: Mapping[str, Any]) -> tuple[str, str]:
    for name in ("first", "second"):
        if not isinstance(row.get(name), str):
            raise DataError(f"the benchmark's data has a comparison without its '{name}' method")
    return str(row["first"]), str(row["second"])


def _partings(comparisons: Sequence[Any]) -> Iterator[str]:
    """Say under which disturbances two methods differ by more than the number of trials can blur."""
    certain = corrected_pairs(comparisons, disturbed=True)
    for row in comparisons:
        if not isinstance(row, Mapping) or row.get("condition") == CLEAN:
            continue
        p_value, difference = finite(row.get("p_value")), finite(row.get("rate_difference"))
        low, high = finite(row.get("rate_difference_low")), finite(row.get("rate_difference_high"))
        if p_value is None or difference is None or low is None or high is None:
            continue
        first, second = _pair(row)
        corrected = certain[str(row.get("condition")), frozenset((first, second))]
        if corrected >= CERTAIN:
            continue
        better, worse = (first, second) if difference > 0 else (second, first)
        sign = 1.0 if difference > 0 else -1.0
        ends = sorted((sign * low, sign * high))
        yield stated(
            f"Under {row['condition']}, {better} succeeds more often than {worse} on the same starts, by "
            f"{100 * abs(difference):.0f} points (95 % interval {points(ends[0])} to {points(ends[1])}, exact McNemar p = {p_value:.2g}, "
            f"{corrected:.2g} corrected for the number of pairs)"
        )
