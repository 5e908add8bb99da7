"""Figure of a link with delay."""

import csv
from pathlib import Path

import numpy as np

from minidual.show.figures.canvas import LINES, new_figure, save_plot

_PARTS = ("leader_j", "arms_j", "drift")
"""Ends of the columns, one plot each."""
_TITLES = ("Observed energy, leader's port", "Observed energy, arms' port", "Drift")
_UNITS = ("J", "J", "rad (rotation, joints) or m")


def draw_link(table: Path, path: Path) -> None:
    """Draw energies, drift, and when the controllers act.

    Args:
        table: What the link did, tick by tick (CSV).
        path: Of the SVG.
    """
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    time_s = np.array([float(row["time_s"]) for row in rows])
    figure, (axes,) = new_figure(1, len(_PARTS), 12, 3.4)
    for axis, part, title, unit in zip(axes, _PARTS, _TITLES, _UNITS, strict=True):
        columns = [name for name in rows[0] if name.endswith(f" {part}")]
        for k, column in enumerate(columns):
            values = np.array([float(row[column]) for row in rows])
            colour, dashes = LINES[k % len(LINES)]
            group = column.removesuffix(f" {part}")
            axis.plot(time_s, values, color=colour, ls=dashes, lw=1, label=group)
            acts = np.array([float(row[f"{group} {_acts_of(part)}"]) for row in rows]) > 0.0
            axis.plot(time_s[acts], values[acts], ".", color=colour, ms=2)
        axis.set(title=title, xlabel="t [s] (dots: the controller acts)", ylabel=unit)
        axis.legend(fontsize=7)
    save_plot(figure, path)


def _acts_of(part: str) -> str:
    return "leader_acts" if part == "leader_j" else "arms_act"
