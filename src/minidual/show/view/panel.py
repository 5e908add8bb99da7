"""Panel beside the scene: state, forces and sliders."""

from __future__ import annotations

import html
import math
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from viser import uplot

from minidual.show.view.overlay import ARM_RGB, OBJECT_RGB, Array, Overlay, Slider

_FORCE_FULL_N = 80.0
"""Top of the plot: ceiling of the internal force."""
_HISTORY = 200
_FORCES = (
    ("pinch, left hand", ARM_RGB[0]),
    ("pinch, right hand", ARM_RGB[1]),
    ("squeeze along the object", OBJECT_RGB),
)


def table_html(overlay: Overlay, speed: float | None) -> str:
    """Return the state as an HTML table, escaped."""
    rows = [
        ("mode", overlay.mode),
        ("source in control", overlay.source),
        ("state", overlay.state),
        ("status", overlay.status),
        ("simulated time", f"{overlay.time_s:.2f} s"),
        ("speed", "" if speed is None else f"{speed:.2f} x real time"),
    ]
    cells = "".join(_row(name, text) for name, text in rows if text)
    for (name, rgb), force in zip(_FORCES, _forces(overlay) or (), strict=False):
        cells += _row(name, f"{round(force, 1) + 0.0:.1f} N", rgb)  # adding zero removes the sign of -0.0
    title = f"<b>{html.escape(overlay.title)}</b>" if overlay.title else ""
    return f"<div style='padding:4px 12px;font-size:13px'>{title}<table style='width:100%'>{cells}</table></div>"


def _row(name: str, text: str, rgb: tuple[int, int, int] | None = None) -> str:
    mark = "" if rgb is None else f"<span style='color:{_css(rgb)}'>&#9632;</span> "
    value = f"<td style='text-align:right'>{mark}{html.escape(text)}</td>"
    return f"<tr><td style='opacity:.6;padding-right:1em'>{name}</td>{value}</tr>"


def _css(rgb: tuple[int, int, int]) -> str:
    return "rgb({},{},{})".format(*rgb)


def _forces(overlay: Overlay) -> tuple[float, float, float] | None:
    if overlay.pinch_n is None or overlay.internal_n is None:
        return None
    return (*overlay.pinch_n, overlay.internal_n)


class Panel:
    """Panel of one viser server."""

    def __init__(self, server: Any) -> None:
        self._gui = server.gui
        self._gui.configure_theme(show_logo=False, show_share_button=False)
        self._gui.set_panel_label("minidual")
        self._table = self._gui.add_html("starting ...")
        lines = [
            uplot.Series(label=f"{name} [N]", stroke=_css(rgb), width=1.5, points={"show": False})
            for name, rgb in _FORCES
        ]
        self._plot = self._gui.add_uplot(
            data=(np.array([0.0, 1.0]), *np.zeros((3, 2))),
            series=(uplot.Series(label="t [s]"), *lines),
            scales={"x": uplot.Scale(time=False), "y": uplot.Scale(range=(0.0, _FORCE_FULL_N))},
            legend=uplot.Legend(show=False),
            aspect=2.2,
            visible=False,
        )
        self._history: deque[tuple[float, ...]] = deque(maxlen=_HISTORY)
        self._sliders: list[Any] = []
        self._offered: list[Slider] = []
        self._values: list[float] = []

    def show(self, overlay: Overlay, speed: float | None) -> None:
        """Show one instant."""
        self._table.content = table_html(overlay, speed)
        forces = _forces(overlay)
        self._plot.visible = forces is not None
        if forces is None:
            return
        if self._history and overlay.time_s <= self._history[-1][0]:
            self._history.clear()
        self._history.append((overlay.time_s, *forces))
        if len(self._history) > 1:
            self._plot.data = tuple(np.ascontiguousarray(column) for column in np.array(self._history).T)

    def offer(self, sliders: Sequence[Slider]) -> None:
        """Add sliders, a folder per group."""
        self._offered += sliders
        self._values += [slider.value for slider in sliders]
        folders: dict[str, Any] = {}
        for slider in sliders:
            if slider.group not in folders:
                folders[slider.group] = self._gui.add_folder(slider.group, expand_by_default=False)
            step = round((slider.upper - slider.lower) / 500, 4)
            with folders[slider.group]:
                self._sliders.append(
                    self._gui.add_slider(slider.label, slider.lower, slider.upper, step, initial_value=slider.value)
                )

    def values(self) -> Array:
        """Return the values (n,), clipped; non-finite client input is ignored."""
        for k, (handle, slider) in enumerate(zip(self._sliders, self._offered, strict=True)):
            value = float(handle.value)
            if math.isfinite(value):
                self._values[k] = min(slider.upper, max(slider.lower, value))
        return np.array(self._values)
