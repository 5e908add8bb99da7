"""Figure of the experiment: one trace under each arm, and the unstable share by delay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from minidual.show.figures.canvas import LINES, limit_line, new_figure, save_plot
from minidual.show.report.bench import BenchRow
from scripts.bench.joint_wall import WALL_M, Course

_SHOWN = "200 ms"
_MARKERS = ("o", "s", "^", "D")
_LIMIT_MM = 150.0
"""Axes end here: what runs away would hide the rest."""


def draw_passivity(
    rows: Sequence[BenchRow],
    courses: Mapping[str, Course],
    delays: Sequence[str],
    traces_n: int,
    path: Path,
) -> None:
    """Draw the figure.

    Args:
        rows: Of all arms and delays.
        courses: Traces by arm.
        delays: Names of the delays, in the order of the traces.
        traces_n: Traces of each delay.
        path: Of the SVG.
    """
    figure, ((motion, shares),) = new_figure(1, 2, 11, 3.6)
    trace = delays.index(_SHOWN) * traces_n
    by_name = {row.name: row for row in rows}
    for k, (arm, course) in enumerate(courses.items()):
        colour, dashes = LINES[k]
        time_s = course.period_s * np.arange(len(course.leader))
        place_mm = np.clip(1e3 * course.leader[:, trace], -_LIMIT_MM, _LIMIT_MM)
        motion.plot(time_s, place_mm, color=colour, ls=dashes, lw=1, label=arm)
        percent = [by_name[f"{arm}, {delay}"].numbers["unstable_pct"] for delay in delays]
        shares.plot(percent, color=colour, ls=dashes, marker=_MARKERS[k], ms=4, label=arm)
    limit_line(motion, 1e3 * WALL_M, label="wall")
    motion.set(title=f"Leader, {_SHOWN}, one trace", xlabel="t [s]", ylabel="mm")
    motion.legend(fontsize=7)
    shares.set_xticks(range(len(delays)), [delay.split(",")[0] for delay in delays], fontsize=7)
    shares.set(title="Unstable traces", xlabel="round trip", ylabel="%")
    shares.legend(fontsize=7)
    save_plot(figure, path)
