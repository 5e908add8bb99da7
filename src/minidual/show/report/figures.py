"""Figures of the report as SVG.

`Figure.themed` replaces fixed colours by CSS variables for light and dark pages.
"""

import csv
import io
import math
import re
import statistics
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
from matplotlib.figure import Figure as Canvas

from minidual.errors import DataError
from minidual.show.report.tables import INDICATORS, Indicator, Row, Tables
from minidual.trials.conditions import CLEAN

_STYLE_FILE = str(files("minidual.show.report") / "templates/figure.mplstyle")
_STYLE: dict[Any, Any] = {**mpl.rc_params_from_file(_STYLE_FILE, use_default_template=False)}
INK, GRID, FAINT = (_STYLE[name] for name in ("text.color", "grid.color", "xtick.color"))
_CSS = {INK: "var(--ink)", GRID: "var(--line)", FAINT: "var(--muted)"}
COLOURS = ("#2f7fd1", "#e0782f", "#2f9e6e", "#9b6bd3", "#c94f7c", "#7a8694")
_LIMIT = "#c8452f"
_WIDTH_IN = 5.2
_BAND = 0.72
"""Share of the row height used."""
TrialRow = dict[str, str]
"""A row of benchmark.csv."""


class Figure(NamedTuple):
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
def _rows(names: Sequence[str], name: str, height: float) -> Iterator[tuple[Any, Any, io.StringIO]]:
    with mpl.rc_context({**_STYLE, "svg.hashsalt": name}):
        figure = Canvas(figsize=(_WIDTH_IN, 0.95 + 0.47 * height), layout="constrained")
        figure.patch.set_alpha(0.0)
        axes = figure.subplots()
        svg = io.StringIO()
        axes.patch.set_alpha(0.0)
        axes.grid(axis="x", linewidth=0.8)
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(len(names) - 0.45, -0.55)
        yield figure, axes, svg
        figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})


def success_figure(rows: Sequence[Row]) -> Figure | None:
    """Plot success rates with intervals by condition, if any."""
    if not any(cell.success for row in rows for cell in row.cells):
        return None
    count = len(rows[0].cells)
    with _rows([row.condition for row in rows], "success", 0.42 * count * len(rows) + 0.5) as (
        figure,
        axes,
        svg,
    ):
        for i, row in enumerate(rows):
            if i % 2 == 0:
                axes.axhspan(i - 0.5, i + 0.5, color=GRID, alpha=0.35, linewidth=0)
            for k, cell in enumerate(row.cells):
                y = i + _BAND * ((k + 0.5) / count - 0.5)
                rate = cell.success
                colour = COLOURS[k % len(COLOURS)]
                if rate is None:
                    words = "does not apply" if cell.state == "spared" else "missing"
                    axes.text(
                        0,
                        y,
                        f"{cell.method}: {words}",
                        fontsize=7.5,
                        va="center",
                        color=FAINT,
                    )
                    continue
                label = cell.method if i == 0 else None
                axes.plot(
                    [100 * rate.low, 100 * rate.high],
                    [y, y],
                    color=colour,
                    linewidth=2.0,
                    alpha=0.75,
                )
                axes.plot(
                    100 * rate.value,
                    y,
                    "o",
                    color=colour,
                    markersize=6.5,
                    markeredgewidth=0,
                    label=label,
                )
        figure.legend(loc="outside upper center", ncols=count, frameon=False, fontsize=9)
        axes.set_xlim(-2, 102)
        axes.set_xlabel("success, %")
    title = "Success" if len(rows) == 1 else "Success under each condition"
    return Figure(
        "success",
        title,
        "Dots: share of trials that passed. Lines: 95 % Wilson interval.",
        svg.getvalue(),
    )


def read_trials(path: Path) -> list[TrialRow]:
    """Return the undisturbed rows of benchmark.csv; DataError if unreadable."""
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            return [row for row in csv.DictReader(stream) if row["condition"] == CLEAN]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path} cannot be read: {error}") from error


def _value(trial: TrialRow, indicator: Indicator) -> float | None:
    try:
        return float(trial[indicator.column]) * indicator.scale
    except ValueError:
        return None


def strip_figure(
    indicator: Indicator,
    methods: Mapping[str, str],
    trials: Sequence[TrialRow],
) -> Figure | None:
    """Plot every trial and the median of successes, if any; `methods` have their colours."""
    found = [
        (t["method"], t["success"] == "True", x)
        for t in trials
        if (x := _value(t, indicator)) is not None
    ]
    if not found:
        return None
    largest = max(value for *_, value in found)
    limit = (indicator.excellent or math.inf) * indicator.scale
    with _rows(tuple(methods), indicator.key, len(methods)) as (_figure, axes, svg):
        for i, (method, colour) in enumerate(methods.items()):
            mine = [(success, value) for name, success, value in found if name == method]
            for k, (success, value) in enumerate(mine):
                look = {"markersize": 4.5, "alpha": 0.7, "markeredgewidth": 0}
                if not success:
                    look = {"markersize": 5.5, "markeredgewidth": 1.4}
                spread = (0.5 + k * 0.618033988749895) % 1.0
                y = i + 0.36 * (spread - 0.5)
                mark = "o" if success else "x"
                axes.plot(value, y, mark, color=colour, **look)
            if won := [value for success, value in mine if success]:
                axes.plot(
                    [statistics.median(won)] * 2,
                    [i - 0.32, i + 0.32],
                    color=INK,
                    linewidth=2.2,
                )
        if largest > 0.15 * limit:
            label = f"excellent {indicator.excellent_text}"
            axes.axvline(limit, color=_LIMIT, linewidth=1.1, linestyle=(0, (4, 3)))
            place = axes.get_xaxis_transform()  # data across, a share of the axes up
            axes.text(
                limit,
                1.01,
                label,
                transform=place,
                ha="center",
                va="bottom",
                fontsize=8,
                color=_LIMIT,
            )
            largest = max(largest, limit)
        axes.set_xlim(0, largest * 1.08 or 1.0)
        axes.locator_params(axis="x", nbins=6)
        axes.set_xlabel(f"{indicator.title}, {indicator.unit}")
    return Figure(indicator.key, indicator.title, indicator.meaning, svg.getvalue())


def benchmark_figures(tables: Tables, trials: Sequence[TrialRow]) -> list[Figure]:
    """Return the figures of success under each condition, and of the undisturbed trials."""
    cells = enumerate(tables.clean.cells)
    methods = {
        cell.method: COLOURS[k % len(COLOURS)] for k, cell in cells if cell.state != "spared"
    }
    shown = (
        INDICATORS[1:]
        if tables.own
        else [indicator._replace(excellent=None) for indicator in INDICATORS[1:]]
    )
    drawn = [
        success_figure(tables.rows),
        *(strip_figure(indicator, methods, trials) for indicator in shown),
    ]
    return [figure for figure in drawn if figure is not None]
