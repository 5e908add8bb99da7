"""Panel beside the scene: state, forces and sliders."""

import html
import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from minidual import emergency
from minidual.show.view.overlay import ARM_RGB, OBJECT_RGB, Array, Overlay, Slider

_FORCES = {
    "pinch, left hand": ARM_RGB[0],
    "pinch, right hand": ARM_RGB[1],
    "squeeze along the object": OBJECT_RGB,
}


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
    if overlay.pinch_n is not None and overlay.internal_n is not None:
        for (name, rgb), force in zip(
            _FORCES.items(),
            (*overlay.pinch_n, overlay.internal_n),
            strict=True,
        ):
            cells += _row(
                name,
                f"{round(force, 1) + 0.0:.1f} N",
                rgb,
            )  # adding zero removes the sign of -0.0
    title = f"<b>{html.escape(overlay.title)}</b>" if overlay.title else ""
    return f"<div style='padding:4px 12px;font-size:13px'>{title}<table style='width:100%'>{cells}</table></div>"


def _row(name: str, text: str, rgb: tuple[int, int, int] | None = None) -> str:
    mark = "" if rgb is None else f"<span style='color:rgb{rgb}'>&#9632;</span> "
    value = f"<td style='text-align:right'>{mark}{html.escape(text)}</td>"
    return f"<tr><td style='opacity:.6;padding-right:1em'>{name}</td>{value}</tr>"


class Panel:
    """Panel of one viser server."""

    def __init__(self, server: Any) -> None:
        self._gui = server.gui
        self._gui.configure_theme(show_logo=False, show_share_button=False)
        self._gui.set_panel_label("minidual")
        self._table = self._gui.add_html("starting ...")
        self._stop = self._gui.add_button("Emergency stop", color="red")
        self._stop.on_click(lambda _: emergency.press("button of the view"))
        self._seen = (0.0, math.inf)
        self._sliders: list[tuple[Any, Slider]] = []
        self._values: list[float] = []

    def show(self, overlay: Overlay) -> None:
        """Show one instant, and the speed since the last one shown."""
        (then, before_s) = self._seen
        now = time.monotonic()
        speed = (overlay.time_s - before_s) / (now - then) if overlay.time_s > before_s else None
        self._seen = (now, overlay.time_s)
        self._table.content = table_html(overlay, speed)

    def note(self, text: str) -> None:
        """Add a line below the state."""
        self._gui.add_html(
            f"<div style='padding:4px 12px;font-size:13px;opacity:.6'>{html.escape(text)}</div>",
        )

    def offer(self, sliders: Sequence[Slider]) -> None:
        """Add sliders, a folder per group."""
        self._values += [slider.value for slider in sliders]
        groups = dict.fromkeys(slider.group for slider in sliders)
        folders = {group: self._gui.add_folder(group, expand_by_default=False) for group in groups}
        for s in sliders:
            step = round((s.upper - s.lower) / 500, 4)
            with folders[s.group]:
                handle = self._gui.add_slider(
                    s.label,
                    s.lower,
                    s.upper,
                    step,
                    initial_value=s.value,
                )
            self._sliders.append((handle, s))

    def values(self) -> Array:
        """Return the values (n,), clipped; NaN and infinities are ignored."""
        for k, (handle, slider) in enumerate(self._sliders):
            value = float(handle.value)
            if math.isfinite(value):
                self._values[k] = min(slider.upper, max(slider.lower, value))
        return np.array(self._values)
