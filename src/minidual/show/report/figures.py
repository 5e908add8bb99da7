"""Figures of the report as SVG.

`Figure.themed` replaces fixed colours by CSS variables for light and dark pages.
"""

from __future__ import annotations

import io
import math
import re
import statistics
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure as Canvas

from minidual.show.report.facts import Trial
from minidual.show.report.indicators import INDICATORS, SUCCESS, Indicator
from minidual.show.report.tables import Row, Tables
from minidual.show.report.wording import fault

INK, GRID, FAINT = "#1a2027", "#d9dee4", "#66717e"
_CSS = {INK: "var(--ink)", GRID: "var(--line)", FAINT: "var(--muted)"}
COLOURS = ("#2f7fd1", "#e0782f", "#2f9e6e", "#9b6bd3", "#c94f7c", "#7a8694")
_LIMIT = "#c8452f"
_WIDTH_IN = 5.2
_BAND = 0.72
"""Share of the row height used."""
_STYLE: dict[str, Any] = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 10,
    **dict.fromkeys(("text.color", "ytick.color", "ytick.labelcolor"), INK),
    **dict.fromkeys(("axes.labelcolor", "xtick.color", "xtick.labelcolor"), FAINT),
    **dict.fromkeys(("axes.edgecolor", "grid.color"), GRID),
    **{f"axes.spines.{side}": False for side in ("top", "right", "left")},
    "xtick.major.size": 0,
    "ytick.major.size": 0,
    "axes.axisbelow": True,
}


@dataclass(frozen=True)
class Figure:
    """One figure; `name` is the file stem."""

    name: str
    title: str
    caption: str
    svg: str

    @property
    def themed(self) -> str:
        """SVG for inlining: CSS colours, no header or size."""
        body = self.svg[self.svg.index("<svg") :]
        for colour, variable in _CSS.items():
            body = body.replace(colour, variable)
        body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
        body = re.sub(r'(<svg[^>]*?) width="[^"]*" height="[^"]*"', r"\1", body, count=1)
        label = self.title.replace("&", "&amp;").replace('"', "&quot;")
        return body.replace("<svg ", f'<svg role="img" aria-label="{label}" ', 1)


@contextmanager
def _rows(names: Sequence[str], name: str, height: float) -> Iterator[tuple[Any, Any, Callable[[], str]]]:
    """Yield (figure, axes, svg) with a row per name; svg() renders."""
    style: Any = {**_STYLE, "svg.hashsalt": name}
    with mpl.rc_context(style):
        figure = Canvas(figsize=(_WIDTH_IN, 0.95 + 0.47 * height), layout="constrained")
        figure.patch.set_alpha(0.0)
        axes = figure.subplots()
        axes.patch.set_alpha(0.0)
        axes.grid(axis="x", linewidth=0.8)
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(len(names) - 0.45, -0.55)

        def svg() -> str:
            text = io.StringIO()
            figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
            return text.getvalue()

        yield figure, axes, svg


def _limit_line(axes: Any, at: float, label: str) -> None:
    axes.axvline(at, color=_LIMIT, linewidth=1.1, linestyle=(0, (4, 3)))
    axes.annotate(
        label, (at, 1.0), xycoords=("data", "axes fraction"), xytext=(0, 2), textcoords="offset points",
        ha="center", va="bottom", fontsize=8, color=_LIMIT,
    )  # fmt: skip


def success_figure(rows: Sequence[Row], name: str, title: str) -> Figure | None:
    """Plot success rates with intervals by condition, if any."""
    if not any(cell.success for row in rows for cell in row.cells):
        return None
    methods = [cell.method for cell in rows[0].cells]
    names = methods if len(rows) == 1 else [row.condition for row in rows]
    height = len(methods) if len(rows) == 1 else 0.42 * len(methods) * len(rows)
    with _rows(names, name, height) as (figure, axes, svg):
        for i, row in enumerate(rows):
            if len(rows) > 1 and i % 2 == 0:
                axes.axhspan(i - 0.5, i + 0.5, color=GRID, alpha=0.35, linewidth=0)
            for k, cell in enumerate(row.cells):
                y = k if len(rows) == 1 else i + _BAND * ((k + 0.5) / len(methods) - 0.5)
                rate, colour = cell.success, COLOURS[k % len(COLOURS)]
                if rate is None:
                    words = "does not apply" if cell.state == "spared" else "missing"
                    axes.text(0, y, f"{cell.method}: {words}", fontsize=7.5, va="center", color=FAINT)
                    continue
                label = cell.method if i == 0 else None
                axes.plot([100 * rate.low, 100 * rate.high], [y, y], color=colour, linewidth=2.0, alpha=0.75)
                axes.plot(100 * rate.value, y, "o", color=colour, markersize=6.5, markeredgewidth=0, label=label)
        if len(rows) > 1:
            figure.legend(loc="outside upper center", ncols=len(methods), frameon=False, fontsize=9)
        else:
            _limit_line(axes, 100.0 * float(SUCCESS.excellent or 0.0), f"excellent {SUCCESS.excellent_text}")
        axes.set_xlim(-2, 102)
        axes.set_xlabel("success, %")
        return Figure(name, title, "Dots: share of trials that passed. Lines: 95 % Wilson interval.", svg())


def strip_figure(indicator: Indicator, methods: Sequence[str], trials: Sequence[Trial]) -> Figure | None:
    """Plot every trial and the median of successes, if any."""
    column = indicator.column or ""
    found = {
        m: [t for t in trials if t.method == m and math.isfinite(t.numbers.get(column, math.nan))] for m in methods
    }
    if not any(found.values()):
        return None
    largest = indicator.scale * max(trial.numbers[column] for mine in found.values() for trial in mine)
    with _rows(methods, indicator.key, len(methods)) as (_figure, axes, svg):
        for i, mine in enumerate(found.values()):
            for k, trial in enumerate(mine):
                y = i + 0.36 * (_spread(k) - 0.5)
                look = {"markersize": 4.5, "alpha": 0.7, "markeredgewidth": 0}
                if not trial.success:
                    look = {"markersize": 5.5, "markeredgewidth": 1.4}
                mark = "o" if trial.success else "x"
                axes.plot(trial.numbers[column] * indicator.scale, y, mark, color=COLOURS[i % len(COLOURS)], **look)
            won = [trial.numbers[column] * indicator.scale for trial in mine if trial.success]
            if won:
                axes.plot([statistics.median(won)] * 2, [i - 0.32, i + 0.32], color=INK, linewidth=2.2)
        limit = (indicator.excellent or math.inf) * indicator.scale
        if largest > 0.15 * limit:
            _limit_line(axes, limit, f"excellent {indicator.excellent_text}")
            largest = max(largest, limit)
        axes.set_xlim(0, largest * 1.08 or 1.0)
        axes.locator_params(axis="x", nbins=6)
        axes.set_xlabel(f"{indicator.title}, {indicator.unit}")
        caption = "Dots: successful trials. Crosses: failed ones. Bar: median of the successful ones."
        return Figure(indicator.key, indicator.title, caption, svg())


def _spread(k: int) -> float:
    """Golden-ratio sequence in [0, 1): even and repeatable."""
    return (0.5 + k * 0.618033988749895) % 1.0


def failures_figure(methods: Sequence[str], trials: Sequence[Trial]) -> Figure | None:
    """Plot failure counts by method, if any."""
    counts = {m: Counter(t.failure or "unnamed" for t in trials if t.method == m and not t.success) for m in methods}
    reasons = [name for name, _n in sum(counts.values(), Counter[str]()).most_common()]
    if not reasons:
        return None
    with _rows(methods, "failures", len(methods) + (len(reasons) + 1) // 2) as (figure, axes, svg):
        left = [0] * len(methods)
        for k, reason in enumerate(reasons):
            widths = [counts[method][reason] for method in methods]
            colour = COLOURS[k % len(COLOURS)]
            axes.barh(range(len(methods)), widths, left=left, height=0.5, color=colour, label=fault(reason))
            left = [start + width for start, width in zip(left, widths, strict=True)]
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.set_xlabel("failed trials")
        figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
        return Figure("failures", "Reasons of failure", "What failed first in each failed trial.", svg())


def benchmark_figures(tables: Tables, trials: Sequence[Trial]) -> list[Figure]:
    """Return the figures of undisturbed trials."""
    methods = [cell.method for cell in tables.clean.cells]
    strips = (strip_figure(indicator, methods, trials) for indicator in INDICATORS[1:])
    drawn = [success_figure(tables.rows[:1], "success", "Success"), *strips, failures_figure(methods, trials)]
    return [figure for figure in drawn if figure is not None]


def condition_figure(tables: Tables) -> Figure | None:
    """Plot success by condition, if disturbed."""
    title = "Success under each disturbance, the first row undisturbed"
    return success_figure(tables.rows, "conditions", title) if len(tables.rows) > 1 else None
