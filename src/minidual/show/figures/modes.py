"""Figure of a mode demonstration without pictures: joints and set-points over time."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from minidual.show.figures.canvas import LINES, new_figure, save_plot

_SHADES = {"moveit": "#206cd6", "teleop": "#148c5a", "policy": "#963ebe"}
_PLOTS = {
    "speed_max_rad_s": ("Fastest joint", "rad/s"),
    "reference_step_max_rad": ("Reference step", "rad"),
    "torque_step_max_nm": ("Torque step", "Nm"),
}


def draw_modes(rows: Sequence[Mapping[str, object]], path: Path) -> None:
    """Draw the log of a demonstration over bands that say which mode drives.

    Args:
        rows: Of `ModesDemo`, in the order of time.
        path: Of the SVG.
    """
    time_s = np.array([float(str(row["time_s"])) for row in rows])
    drivers = [str(row["active_source"]) for row in rows]
    figure, (axes,) = new_figure(1, len(_PLOTS), 12, 3.4)
    for axis, (column, (title, unit)) in zip(axes, _PLOTS.items(), strict=True):
        values = np.array([float(str(row[column])) for row in rows])
        colour, dashes = LINES[0]
        axis.plot(time_s, values, color=colour, ls=dashes, lw=1)
        for mode, shade in _SHADES.items():
            drives = np.array([driver == mode for driver in drivers])
            if drives.any():
                top = max(float(values.max()), 1e-9)
                axis.fill_between(
                    time_s, 0.0, top, where=drives, color=shade, alpha=0.15, label=mode
                )
        axis.set(title=title, xlabel="t [s]", ylabel=unit)
        axis.legend(fontsize=7)
    save_plot(figure, path)
