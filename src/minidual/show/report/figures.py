"""Figures of the report as SVG, drawn from data; the same drawing serves light and dark pages.

Matplotlib draws with placeholder colours for ink, grid and paper, and `themed` turns those into CSS variables.
The file version keeps real colours, so that a figure can be used elsewhere.
"""

from __future__ import annotations

import io
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from minidual.show.report.captions import fault
from minidual.show.report.comparison import Comparison
from minidual.show.report.indicators import INDICATORS, Indicator
from minidual.show.report.trials import Trial, of_method, values

INK, GRID, FAINT = "#1a2027", "#d9dee4", "#66717e"
_CSS = {INK: "var(--ink)", GRID: "var(--line)", FAINT: "var(--muted)"}
COLOURS = ("#2f7fd1", "#e0782f", "#2f9e6e", "#9b6bd3", "#c94f7c", "#7a8694")
_LIMIT = "#c8452f"
_WIDTH_IN = 5.2


@dataclass(frozen=True)
class Figure:
    """One figure: name for its file, title and caption for people, and the SVG text with real colours."""

    name: str
    title: str
    caption: str
    svg: str

    @property
    def themed(self) -> str:
        """The SVG for the page: no XML head, colours as CSS variables, scaled to its frame."""
        body = self.svg[self.svg.index("<svg") :]
        for colour, variable in _CSS.items():
            body = body.replace(colour, variable)
        body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
        body = re.sub(r'(<svg[^>]*?) width="[^"]*" height="[^"]*"', r"\1", body, count=1)
        label = self.title.replace("&", "&amp;").replace('"', "&quot;")
        return body.replace("<svg ", f'<svg role="img" aria-label="{label}" ', 1)


@contextmanager
def row_axes(rows: float, name: str) -> Iterator[tuple[Any, Any, Callable[[], str]]]:
    """Yield (figure, axes, svg) for `rows` horizontal rows; `svg()` gives the text after drawing."""
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure as Canvas

    style = {
        "svg.fonttype": "none",
        "svg.hashsalt": name,
        "font.family": "sans-serif",
        "font.size": 10,
        "text.color": INK,
        "axes.labelcolor": FAINT,
        "axes.edgecolor": GRID,
        "xtick.color": FAINT,
        "ytick.color": INK,
        "xtick.labelcolor": FAINT,
        "ytick.labelcolor": INK,
        "grid.color": GRID,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.spines.left": False,
        "xtick.major.size": 0,
        "ytick.major.size": 0,
        "axes.axisbelow": True,
    }
    with mpl.rc_context(style):
        figure = Canvas(figsize=(_WIDTH_IN, 0.95 + 0.47 * rows), layout="constrained")
        FigureCanvasSVG(figure)
        figure.patch.set_alpha(0.0)
        axes = figure.subplots()
        axes.patch.set_alpha(0.0)
        axes.grid(axis="x", linewidth=0.8)

        def svg() -> str:
            text = io.StringIO()
            figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
            return text.getvalue()

        yield figure, axes, svg


def label_rows(axes: Any, names: Sequence[str]) -> None:
    """Name the rows, the first at the top."""
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.45, -0.55)


def _limit_line(axes: Any, at: float, label: str) -> None:
    axes.axvline(at, color=_LIMIT, linewidth=1.1, linestyle=(0, (4, 3)))
    axes.annotate(
        label,
        (at, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(0, 2),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=8,
        color=_LIMIT,
    )


def success_figure(comparison: Comparison) -> Figure | None:
    """Success rate of each method with its interval; None without a rate."""
    rows = [row for row in comparison.rows if row.cell("success_rate").value is not None]
    if not rows:
        return None
    with row_axes(len(rows), "success") as (_figure, axes, svg):
        for i, row in enumerate(rows):
            rate, colour = 100.0 * (row.cell("success_rate").value or 0.0), COLOURS[i % len(COLOURS)]
            axes.barh(i, rate, height=0.5, color=colour, alpha=0.85)
            if row.low is not None and row.high is not None:
                axes.plot([100 * row.low, 100 * row.high], [i, i], color=INK, linewidth=1.6)
                for end in (row.low, row.high):
                    axes.plot([100 * end] * 2, [i - 0.12, i + 0.12], color=INK, linewidth=1.6)
        label_rows(axes, [row.method for row in rows])
        _limit_line(axes, 80.0, "excellent > 80 %")
        axes.set_xlim(0, 101)
        axes.set_xlabel("success, %")
        return Figure("success", "Success", "Bars: share of trials. Lines: 95 % Wilson interval.", svg())


def strip_figure(indicator: Indicator, comparison: Comparison, trials: Sequence[Trial]) -> Figure | None:
    """Every trial of every method as a point, the median as a bar; None without a value."""
    column = indicator.column
    methods = [row.method for row in comparison.rows]
    if column is None or not any(values(of_method(trials, method), column) for method in methods):
        return None
    with row_axes(len(methods), indicator.key) as (_figure, axes, svg):
        largest = 0.0
        for i, method in enumerate(methods):
            mine = [t for t in of_method(trials, method) if math.isfinite(t.numbers[column])]
            for k, trial in enumerate(mine):
                x = trial.numbers[column] * indicator.scale
                y = i + 0.36 * (_spread(k) - 0.5)
                colour = COLOURS[i % len(COLOURS)]
                if trial.success:
                    axes.plot(x, y, "o", color=colour, markersize=4.5, alpha=0.7, markeredgewidth=0)
                else:
                    axes.plot(x, y, "x", color=colour, markersize=5.5, markeredgewidth=1.4)
                largest = max(largest, x)
            won = [t.numbers[column] for t in mine if t.success]
            if won:
                middle = sorted(won)[len(won) // 2] * indicator.scale
                axes.plot([middle, middle], [i - 0.32, i + 0.32], color=INK, linewidth=2.2)
        label_rows(axes, methods)
        if indicator.excellent is not None:
            at = indicator.excellent * indicator.scale
            if largest > 0.15 * at:
                _limit_line(axes, at, f"excellent {indicator.excellent_text()}")
                largest = max(largest, at)
        axes.set_xlim(0, largest * 1.08 or 1.0)
        axes.locator_params(axis="x", nbins=6)
        axes.set_xlabel(f"{indicator.noun}, {indicator.unit}")
        caption = "Dots: successful trials. Crosses: failed ones. Bar: median of the successful ones."
        return Figure(indicator.key, indicator.title, caption, svg())


def _spread(k: int) -> float:
    """Return the k-th number in [0, 1) of the golden-ratio sequence: even, and the same every time."""
    return (0.5 + k * 0.618033988749895) % 1.0


def failures_figure(comparison: Comparison, trials: Sequence[Trial]) -> Figure | None:
    """Reasons of failure by method, stacked; None if nothing failed."""
    counts: dict[str, Counter[str]] = {}
    for row in comparison.rows:
        seen = Counter(t.failure or "unnamed" for t in of_method(trials, row.method) if not t.success)
        counts[row.method] = seen or Counter(dict(row.failures))
    reasons = [name for name, _n in sum(counts.values(), Counter[str]()).most_common()]
    if not reasons:
        return None
    with row_axes(len(counts) + (len(reasons) + 1) // 2, "failures") as (figure, axes, svg):
        start = dict.fromkeys(counts, 0)
        for k, reason in enumerate(reasons):
            widths = [counts[method][reason] for method in counts]
            axes.barh(
                range(len(counts)),
                widths,
                left=[start[m] for m in counts],
                height=0.5,
                color=COLOURS[k % len(COLOURS)],
                label=fault(reason),
            )
            for method, width in zip(counts, widths, strict=True):
                start[method] += width
        label_rows(axes, list(counts))
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.set_xlabel("failed trials")
        figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9)
        return Figure("failures", "Reasons of failure", "What failed first in each failed trial.", svg())


def benchmark_figures(comparison: Comparison, trials: Sequence[Trial]) -> list[Figure]:
    """Return every figure of the comparison for which there is data."""
    drawn = [
        success_figure(comparison),
        *(strip_figure(indicator, comparison, trials) for indicator in INDICATORS[1:]),
        failures_figure(comparison, trials),
    ]
    return [figure for figure in drawn if figure is not None]
