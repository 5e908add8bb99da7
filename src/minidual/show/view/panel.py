"""Panel beside the scene: state, forces and sliders."""

import html
import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from minidual import emergency
from minidual.show.view.overlay import ARM_RGB, OBJECT_RGB, Array, Overlay, Slider

_STYLE = "padding:4px 12px;font-size:13px"
_SLIDER_STEPS_N = 500


def table_html(overlay: Overlay, speed: float | None) -> str:
    """Return the state as an HTML table, escaped."""
    texts = {
        "method": overlay.method,
        "mode": overlay.mode,
        "source in control": overlay.source,
        "controller": overlay.controller,
        "state": overlay.state,
        "status": overlay.status,
        "plan": overlay.plan,
        "simulated time": f"{overlay.time_s:.2f} s",
        "speed": "" if speed is None else f"{speed:.2f} x real time",
    }
    rows = [_row(name, text) for name, text in texts.items() if text]
    rows += [_row(html.escape(name), text) for name, text in overlay.lines]
    if overlay.pinch_n is not None and overlay.internal_n is not None:
        left_n, right_n = overlay.pinch_n
        rows += [
            _row("pinch, left hand", _force(left_n), ARM_RGB[0]),
            _row("pinch, right hand", _force(right_n), ARM_RGB[1]),
            _row("squeeze along the object", _force(overlay.internal_n), OBJECT_RGB),
        ]
    title = f"<b>{html.escape(overlay.title)}</b>" if overlay.title else ""
    return f"<div style='{_STYLE}'>{title}<table style='width:100%'>{''.join(rows)}</table></div>"


def _force(force_n: float) -> str:
    rounded = round(force_n, 1) + 0.0  # adding zero removes the sign of -0.0
    return f"{rounded:.1f} N"


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
        self._shown_at_s = 0.0
        self._shown_time_s = math.inf
        self._sliders: list[tuple[Any, Slider]] = []
        self._values: list[float] = []
        self._choice = ""

    def show(self, overlay: Overlay) -> None:
        """Show one instant, and the speed since the last one shown."""
        now_s = time.monotonic()
        speed = None
        if overlay.time_s > self._shown_time_s:
            speed = (overlay.time_s - self._shown_time_s) / (now_s - self._shown_at_s)
        self._shown_at_s = now_s
        self._shown_time_s = overlay.time_s
        self._table.content = table_html(overlay, speed)

    def note(self, text: str) -> None:
        """Add a line below the state."""
        self._gui.add_html(f"<div style='{_STYLE};opacity:.6'>{html.escape(text)}</div>")

    def offer_choice(self, title: str, names: Sequence[str]) -> None:
        """Add a button for each name, in a folder; `choice` is the one pressed last."""
        with self._gui.add_folder(title):
            for name in names:
                self._add_choice(name)

    def _add_choice(self, name: str) -> None:
        self._gui.add_button(name).on_click(lambda _: self.choose(name))

    def choose(self, name: str) -> None:
        """Act as if the button was pressed."""
        self._choice = name

    @property
    def choice(self) -> str:
        """Name of the button pressed last; empty before."""
        return self._choice

    def offer(self, sliders: Sequence[Slider]) -> None:
        """Add sliders, a folder per group."""
        groups = dict.fromkeys(slider.group for slider in sliders)
        folders = {group: self._gui.add_folder(group) for group in groups}
        for slider in sliders:
            step = round((slider.upper - slider.lower) / _SLIDER_STEPS_N, 4)
            with folders[slider.group]:
                handle = self._gui.add_slider(
                    slider.label,
                    slider.lower,
                    slider.upper,
                    step,
                    initial_value=slider.value,
                )
            self._sliders.append((handle, slider))
            self._values.append(slider.value)

    def values(self) -> Array:
        """Return the sliders' values (n,), clipped; NaN and infinities are ignored."""
        for k, (handle, slider) in enumerate(self._sliders):
            value = float(handle.value)
            if math.isfinite(value):
                self._values[k] = min(slider.upper, max(slider.lower, value))
        return np.array(self._values)
