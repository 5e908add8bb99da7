"""Figures of the report as SVG.

`Figure.themed` replaces fixed colours by CSS variables for light and dark pages.
"""

import csv
import html
import io
import math
import re
import statistics
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
from matplotlib.figure import Figure as Canvas

from minidual.errors import DataError
from minidual.show.report.indicators import INDICATORS, Indicator
from minidual.show.report.tables import Cell, IndicatorValue, Row, Tables
from minidual.show.report.words import Words
from minidual.trials.conditions import CLEAN

_STYLE_FILE = str(files("minidual.show.report") / "templates/figure.mplstyle")
_STYLE: dict[Any, Any] = {**mpl.rc_params_from_file(_STYLE_FILE, use_default_template=False)}
INK = _STYLE["text.color"]
GRID = _STYLE["grid.color"]
FAINT = _STYLE["xtick.color"]
_CSS = {INK: "var(--ink)", GRID: "var(--line)", FAINT: "var(--muted)"}


class Look(NamedTuple):
    """How a method is drawn: apart in colour, in grey and in shape."""

    colour: str
    marker: str


LOOKS = (
    Look("#1f5fa8", "o"),
    Look("#e0782f", "s"),
    Look("#1e7a52", "^"),
    Look("#a983dd", "D"),
    Look("#a83462", "v"),
    Look("#7a8694", "P"),
)
"""Of the methods, in the order of the columns."""
_LIMIT = "#c8452f"
_ENGLISH = Words("en")
_WIDTH_IN = 5.2
_BAND = 0.72
"""Share of the row height that a condition's methods use."""
_STRIP = 0.36
"""Share of the row height over which a method's trials are spread."""
_GOLDEN = 0.618033988749895
"""Multiples of it, modulo 1, spread evenly: trials do not hide each other."""
_LIMIT_SHOWN_FROM = 0.15
"""The limit is drawn if the largest value exceeds this share of it."""

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


@dataclass
class _RowChart:
    """A chart with one named row per item; `svg` is set when the drawing is finished."""

    figure: Canvas
    axes: Any
    svg: str = ""


@contextmanager
def _row_chart(row_names: Sequence[str], name: str, height: float) -> Iterator[_RowChart]:
    """Yield a chart to draw on; `name` makes its SVG reproducible, `height` is in rows."""
    with mpl.rc_context({**_STYLE, "svg.hashsalt": name}):
        figure = Canvas(figsize=(_WIDTH_IN, 0.95 + 0.47 * height), layout="constrained")
        figure.patch.set_alpha(0.0)
        axes = figure.subplots()
        axes.patch.set_alpha(0.0)
        axes.grid(axis="x", linewidth=0.8)
        axes.set_yticks(range(len(row_names)), row_names)
        axes.set_ylim(len(row_names) - 0.45, -0.55)
        chart = _RowChart(figure, axes)
        yield chart
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
        chart.svg = buffer.getvalue()


def success_figure(rows: Sequence[Row], words: Words = _ENGLISH) -> Figure | None:
    """Return the figure of success rates with intervals by condition; None without any rate."""
    if not any(cell.success for row in rows for cell in row.cells):
        return None
    methods_n = len(rows[0].cells)
    conditions = [row.condition for row in rows]
    height = 0.42 * methods_n * len(rows) + 0.5
    with _row_chart(conditions, "success", height) as chart:
        for i, row in enumerate(rows):
            if i % 2 == 0:
                chart.axes.axhspan(i - 0.5, i + 0.5, color=GRID, alpha=0.35, linewidth=0)
            for k, cell in enumerate(row.cells):
                y = i + _BAND * ((k + 0.5) / methods_n - 0.5)
                if cell.success is None:
                    _draw_absence(chart.axes, y, cell)
                else:
                    label = cell.method if i == 0 else None
                    _draw_rate(chart.axes, y, cell.success, look_of(k), label)
        chart.figure.legend(
            loc="outside upper center",
            ncols=methods_n,
            frameon=False,
            fontsize=9,
        )
        chart.axes.set_xlim(-2, 102)
        chart.axes.set_xlabel(_ENGLISH("figure.success_axis"))
    methods = [cell.method for cell in rows[0].cells]
    reasons = ("figure.spared", "figure.missing")
    texts = {_ENGLISH(key): words(key) for key in ("figure.success_axis", *reasons)}
    for method in methods:
        texts |= {f"{method}: {_ENGLISH(key)}": f"{method}: {words(key)}" for key in reasons}
    return Figure(
        "success",
        words("figure.success" if len(rows) == 1 else "figure.success_conditions"),
        words("figure.success_caption"),
        _translated(chart.svg, texts),
    )


def look_of(column: int) -> Look:
    """Return how the method of a column is drawn."""
    return LOOKS[column % len(LOOKS)]


def _translated(svg: str, texts: Mapping[str, str]) -> str:
    """Return an SVG with whole texts replaced: it is drawn with the widths of the English ones."""
    for source, text in texts.items():
        svg = svg.replace(f">{html.escape(source)}<", f">{html.escape(text)}<")
    return svg


def _draw_absence(axes: Any, y: float, cell: Cell) -> None:
    """Write why a cell has no success rate."""
    reason = _ENGLISH("figure.spared" if cell.state == "spared" else "figure.missing")
    axes.text(0, y, f"{cell.method}: {reason}", fontsize=7.5, va="center", color=FAINT)


def _draw_rate(
    axes: Any,
    y: float,
    rate: IndicatorValue,
    look: Look,
    label: str | None,
) -> None:
    """Draw a success rate and its interval."""
    interval = [100 * rate.low, 100 * rate.high]
    axes.plot(interval, [y, y], color=look.colour, linewidth=2.0, alpha=0.75)
    axes.plot(
        100 * rate.value,
        y,
        look.marker,
        color=look.colour,
        markersize=6.5,
        markeredgewidth=0,
        label=label,
    )


def read_trials(path: Path) -> list[TrialRow]:
    """Return the undisturbed rows of benchmark.csv.

    Raises:
        DataError: It cannot be read.
    """
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            return [row for row in csv.DictReader(stream) if row["condition"] == CLEAN]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path} cannot be read: {error}") from error


class _Point(NamedTuple):
    """One trial of a strip figure; `value` in the displayed unit."""

    method: str
    success: bool
    value: float


def strip_figure(
    indicator: Indicator,
    methods: Mapping[str, Look],
    trials: Sequence[TrialRow],
    words: Words = _ENGLISH,
) -> Figure | None:
    """Return the figure of every trial and the median of the successes; None without values.

    Args:
        indicator: What is drawn.
        methods: {method: its look}.
        trials: Rows of benchmark.csv.
        words: Of the page's language.
    """
    points = _points(indicator, trials)
    if not points:
        return None
    largest = max(point.value for point in points)
    limit = (indicator.excellent or math.inf) * indicator.scale
    with _row_chart(tuple(methods), indicator.key, len(methods)) as chart:
        for i, (method, look) in enumerate(methods.items()):
            own_points = [point for point in points if point.method == method]
            _draw_strip(chart.axes, i, own_points, look)
        if largest > _LIMIT_SHOWN_FROM * limit:
            _draw_limit(chart.axes, limit, f"excellent {indicator.excellent_text}")
            largest = max(largest, limit)
        chart.axes.set_xlim(0, largest * 1.08 or 1.0)
        chart.axes.locator_params(axis="x", nbins=6)
        chart.axes.set_xlabel(f"{indicator.title}, {indicator.unit}")
    title = words.indicator(indicator)
    unit = words.unit(indicator.unit)
    excellent = indicator.excellent_text
    texts = {
        f"{indicator.title}, {indicator.unit}": f"{title}{words('comma')}{unit}",
        f"excellent {excellent}": (
            f"{words('figure.excellent')} {excellent.replace(indicator.unit, unit)}"
        ),
    }
    svg = _translated(chart.svg, texts)
    return Figure(indicator.key, title, words.meaning(indicator), svg)


def _points(indicator: Indicator, trials: Sequence[TrialRow]) -> list[_Point]:
    points: list[_Point] = []
    for trial in trials:
        try:
            value = float(trial[indicator.column]) * indicator.scale
        except ValueError:  # an empty cell: the trial has no value
            continue
        points.append(_Point(trial["method"], trial["success"] == "True", value))
    return points


def _draw_strip(axes: Any, row: int, points: Sequence[_Point], look: Look) -> None:
    """Draw the trials of one method: markers for successes, crosses for failures, a bar at the median."""
    for k, point in enumerate(points):
        spread = (0.5 + k * _GOLDEN) % 1.0
        y = row + _STRIP * (spread - 0.5)
        if point.success:
            dot = {"markersize": 4.5, "alpha": 0.7, "markeredgewidth": 0}
            axes.plot(point.value, y, look.marker, color=look.colour, **dot)
        else:
            cross = {"markersize": 5.5, "markeredgewidth": 1.4}
            axes.plot(point.value, y, "x", color=look.colour, **cross)
    successes = [point.value for point in points if point.success]
    if successes:
        median = statistics.median(successes)
        axes.plot([median, median], [row - 0.32, row + 0.32], color=INK, linewidth=2.2)


def _draw_limit(axes: Any, limit: float, label: str) -> None:
    axes.axvline(limit, color=_LIMIT, linewidth=1.1, linestyle=(0, (4, 3)))
    above_the_axes = axes.get_xaxis_transform()  # x in data units, y as a share of the axes
    axes.text(
        limit,
        1.01,
        label,
        transform=above_the_axes,
        ha="center",
        va="bottom",
        fontsize=8,
        color=_LIMIT,
    )


def benchmark_figures(
    tables: Tables,
    trials: Sequence[TrialRow],
    words: Words = _ENGLISH,
) -> list[Figure]:
    """Return the figures of success under each condition, and of the undisturbed trials."""
    methods = {
        cell.method: look_of(k)
        for k, cell in enumerate(tables.clean.cells)
        if cell.state != "spared"
    }
    figures = [success_figure(tables.rows, words)]
    for indicator in INDICATORS[1:]:
        shown = indicator if tables.own else replace(indicator, excellent=None)
        figures.append(strip_figure(shown, methods, trials, words))
    return [figure for figure in figures if figure is not None]
