"""The panel beside the scene: who drives, how hard the hands press, how fast time goes by."""

from __future__ import annotations

import html
import math
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from minidual.show.view.overlay import LEFT_RGB, OBJECT_RGB, RIGHT_RGB, Array, Overlay, Slider

_FORCE_FULL_N = 80.0
"""A full bar: the ceiling of the internal force."""
_HISTORY = 200
_MODE_RGB = {"moveit": (32, 108, 214), "teleop": (214, 118, 20), "policy": (150, 62, 190), "impedance": (20, 150, 90)}
_IDLE_RGB = (100, 110, 125)


def _css(rgb: tuple[int, int, int]) -> str:
    return f"rgb({rgb[0]},{rgb[1]},{rgb[2]})"


def _row(label: str, value: str) -> str:
    return (
        "<div style='display:flex;justify-content:space-between;gap:1em;padding:1px 0'>"
        f"<span style='opacity:.6'>{html.escape(label)}</span>"
        f"<span style='font-weight:600;text-align:right'>{html.escape(value)}</span></div>"
    )


def _bar(label: str, value_n: float, rgb: tuple[int, int, int]) -> str:
    value_n = round(value_n, 1) + 0.0  # no minus before zero
    share = 100.0 * min(1.0, max(0.0, value_n / _FORCE_FULL_N))
    return (
        "<div style='margin:5px 0'><div style='display:flex;justify-content:space-between'>"
        f"<span style='opacity:.6'>{label}</span>"
        f"<span style='font-weight:600;font-variant-numeric:tabular-nums'>{value_n:.1f} N</span></div>"
        "<div style='height:7px;border-radius:4px;background:rgba(128,128,128,.22)'>"
        f"<div style='height:7px;border-radius:4px;width:{share:.1f}%;background:{_css(rgb)}'></div></div></div>"
    )


def state_html(overlay: Overlay, speed: float | None) -> str:
    """Return the table of who drives; every text is escaped."""
    chip = ""
    if overlay.mode:
        rgb = _MODE_RGB.get(overlay.mode, _IDLE_RGB)
        chip = (
            f"<span style='background:{_css(rgb)};color:white;border-radius:10px;padding:1px 10px;font-weight:700'>"
            f"{html.escape(overlay.mode)}</span>"
        )
    title = (
        f"<div style='font-weight:700;margin-bottom:6px'>{html.escape(overlay.title)}</div>" if overlay.title else ""
    )
    mode = (
        f"<div style='display:flex;justify-content:space-between'><span style='opacity:.6'>mode</span>{chip}</div>"
        if chip
        else ""
    )
    rows = [
        _row(label, text)
        for label, text in (("source in control", overlay.source), ("state", overlay.state), ("", overlay.status))
        if text
    ]
    rows.append(_row("simulated time", f"{overlay.time_s:.2f} s"))
    if speed is not None:
        rows.append(_row("speed", f"{speed:.2f} x real time"))
    return f"<div style='padding:4px 12px;font-size:13px;line-height:1.5'>{title}{mode}{''.join(rows)}</div>"


def forces_html(overlay: Overlay) -> str:
    """Return the bars of the forces, or a line saying that none are measured."""
    bars = ""
    if overlay.pinch_n is not None:
        bars += _bar("pinch, left hand", overlay.pinch_n[0], LEFT_RGB)
        bars += _bar("pinch, right hand", overlay.pinch_n[1], RIGHT_RGB)
    if overlay.internal_n is not None:
        bars += _bar("squeeze along the object", overlay.internal_n, OBJECT_RGB)
    body = bars or "<span style='opacity:.6'>not measured here</span>"
    return f"<div style='padding:0 12px;font-size:13px'>{body}</div>"


class WebPanel:
    """The panel of one server."""

    def __init__(self, server: Any) -> None:
        from viser import uplot

        self._gui = server.gui
        self._gui.configure_theme(dark_mode=False, show_logo=False, show_share_button=False, brand_color=(214, 108, 20))
        self._gui.set_panel_label("minidual")
        self._state = self._gui.add_html("<div style='padding:4px 12px;font-size:13px'>starting ...</div>")
        with self._gui.add_folder("Forces"):
            self._forces = self._gui.add_html("")
            self._plot = self._gui.add_uplot(
                data=(np.array([0.0, 1.0]), *(np.zeros(2) for _ in range(3))),
                series=(
                    uplot.Series(label="t [s]"),
                    uplot.Series(label="left [N]", stroke=_css(LEFT_RGB), width=1.5, points={"show": False}),
                    uplot.Series(label="right [N]", stroke=_css(RIGHT_RGB), width=1.5, points={"show": False}),
                    uplot.Series(label="squeeze [N]", stroke=_css(OBJECT_RGB), width=1.5, points={"show": False}),
                ),
                scales={"x": uplot.Scale(time=False), "y": uplot.Scale(range=(0.0, _FORCE_FULL_N))},
                legend=uplot.Legend(show=False),
                aspect=2.2,
                visible=False,
            )
        self._history: deque[tuple[float, float, float, float]] = deque(maxlen=_HISTORY)
        self._sliders: list[Any] = []
        self._offered: list[Slider] = []
        self._values: list[float] = []

    def show(self, overlay: Overlay, speed: float | None) -> None:
        """Show the state of one instant."""
        self._state.content = state_html(overlay, speed)
        self._forces.content = forces_html(overlay)
        measured = overlay.pinch_n is not None and overlay.internal_n is not None
        self._plot.visible = measured
        if not measured:
            return
        assert overlay.pinch_n is not None
        assert overlay.internal_n is not None
        if self._history and overlay.time_s <= self._history[-1][0]:
            self._history.clear()
        self._history.append((overlay.time_s, *overlay.pinch_n, overlay.internal_n))
        if len(self._history) > 1:
            columns = np.array(self._history).T
            self._plot.data = tuple(np.ascontiguousarray(c) for c in columns)

    def offer(self, sliders: Sequence[Slider]) -> None:
        """Add sliders, those of one group in one folder."""
        self._offered += sliders
        self._values += [slider.value for slider in sliders]
        folders: dict[str, Any] = {}
        for slider in sliders:
            if slider.group not in folders:
                folders[slider.group] = self._gui.add_folder(slider.group, expand_by_default=False)
            with folders[slider.group]:
                self._sliders.append(
                    self._gui.add_slider(
                        slider.label,
                        min=slider.lower,
                        max=slider.upper,
                        step=round((slider.upper - slider.lower) / 500, 4),
                        initial_value=slider.value,
                    )
                )

    def values(self) -> Array:
        """Return the values (n,) of the sliders, each inside its bounds.

        What arrives was sent by whoever reached the port, not only by a browser that shows these sliders: a value
        that is no number leaves the last one standing.
        """
        for k, (handle, slider) in enumerate(zip(self._sliders, self._offered, strict=True)):
            value = float(handle.value)
            if math.isfinite(value):
                self._values[k] = min(slider.upper, max(slider.lower, value))
        return np.array(self._values)
