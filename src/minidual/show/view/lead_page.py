"""The browser view of a person who leads: handles at the hands, buttons and a status."""

import html
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from minidual.demos.station import PAUSED, Button, HandHandles, HandReading, Station, Status
from minidual.robot.pair import SIDES, Array, pose

_STYLE = "padding:4px 12px;font-size:13px;min-height:110px"
"""With room for five lines: buttons that move under the mouse are pressed by mistake."""
_SHOW_PERIOD_S = 0.15
_HANDLE_SCALE = 0.14
_STILL = 1e-5
"""Change of a pose [m, or of its matrix] that is rounding, not dragging."""
_LABELS = {
    Button.START: ("Start", "green"),
    Button.SUCCESS: ("Success", "teal"),
    Button.FAILURE: ("Failure", "orange"),
    Button.DISCARD: ("Discard, same start again", "gray"),
    Button.PAUSE: ("Pause", "gray"),
    Button.NEXT: ("Next start", "gray"),
    Button.CORRECT: ("Take over, hand back", "blue"),
}


_FIRST = (Button.START, Button.SUCCESS, Button.FAILURE)
"""Buttons of each episode. The others stand below the sliders of the hands, which are used more."""
_LAST_ORDER = 1e6
"""Place of a folder below all others of the panel."""


def status_html(status: Status) -> str:
    """Return the display as HTML, escaped."""
    lines = [f"<b>{html.escape(status.state)}</b>"]
    if status.time_left_s is not None:
        lines.append(f"time left {max(status.time_left_s, 0.0):.0f} s")
    if status.latency_s is not None:
        lines.append(f"latency {1e3 * status.latency_s:.0f} ms")
    if status.held:
        lines.append(f"the arms hold: {html.escape(status.held)}")
    if status.hint:
        lines.append(html.escape(status.hint))
    if status.last:
        lines.append(html.escape(status.last))
    return f"<div style='{_STYLE}'>{'<br>'.join(lines)}</div>"


class LeadPage(Station):
    """The lead panel of one viser server; `latency` returns the round trip to a page [s]."""

    def __init__(self, server: Any, latency: Callable[[], float | None]) -> None:
        self._server = server
        self._latency = latency
        self._presses: deque[Button] = deque()
        self._shown_at_s = float("-inf")
        self._handles: PageHandles | None = None
        with server.gui.add_folder("lead"):
            self._status = server.gui.add_html("")
            self._buttons = {button: self._add_button(button) for button in _FIRST}
        with server.gui.add_folder("more", order=_LAST_ORDER):
            others = [button for button in Button if button not in _FIRST]
            self._buttons |= {button: self._add_button(button) for button in others}

    def _add_button(self, button: Button) -> Any:
        label, color = _LABELS[button]
        handle = self._server.gui.add_button(label, color=color)
        handle.on_click(lambda _: self._presses.append(button))
        return handle

    def show(self, status: Status) -> None:
        """Show the status a few times a second."""
        now_s = time.monotonic()
        if now_s - self._shown_at_s >= _SHOW_PERIOD_S:
            self._shown_at_s = now_s
            self._status.content = status_html(status)
            self._label_pause("Go on" if status.state == PAUSED else _LABELS[Button.PAUSE][0])

    def _label_pause(self, label: str) -> None:
        """Say what the button does now: a click that was missed shows."""
        button = self._buttons[Button.PAUSE]
        if button.label != label:
            button.label = label

    def pressed(self) -> tuple[Button, ...]:
        """Return the buttons pressed since the last call."""
        presses: list[Button] = []
        while self._presses:
            presses.append(self._presses.popleft())
        return tuple(presses)

    def handles(self) -> "PageHandles":
        """Return the handles, added at the first call."""
        if self._handles is None:
            self._handles = PageHandles(self._server, self._latency)
        return self._handles


class PageHandles(HandHandles):
    """A gizmo and a gripper slider a hand, one gizmo between them that moves both, and one clutch.

    Two hands that hold an object must move together, and a mouse drags one gizmo at a time.
    """

    def __init__(self, server: Any, latency: Callable[[], float | None]) -> None:
        self._server = server
        self._latency = latency
        self._gizmos: list[Any] = []
        self._between: Any = None
        self._placed_n = 0
        self._Ts = [np.eye(4), np.eye(4)]
        self._T_between = np.eye(4)
        self._openings = [1.0, 1.0]
        with server.gui.add_folder("hands"):
            self._sliders = [self._add_slider(side) for side in SIDES]
            self._close = server.gui.add_button("Close both hands", color="gray")
            self._close.on_click(lambda _: self._set_both(0.0))
            self._open = server.gui.add_button("Open both hands", color="gray")
            self._open.on_click(lambda _: self._set_both(1.0))
            self._clutch = server.gui.add_checkbox(
                "clutch: move the handles alone",
                initial_value=False,
            )

    def _add_slider(self, side: str) -> Any:
        return self._server.gui.add_slider(
            f"{side} hand open",
            min=0.0,
            max=1.0,
            step=0.05,
            initial_value=1.0,
        )

    def place(self, Ts_world_tcp: Sequence[Array]) -> None:
        """Put new handles at the hands. Scenes that were replaced have lost theirs.

        New handles get new names, so that a drag of the old ones moves nothing.
        """
        for gizmo in self._gizmos:
            gizmo.remove()
        if self._between is not None:
            self._between.remove()
        self._placed_n += 1
        self._Ts = [np.array(T) for T in Ts_world_tcp]
        self._T_between = pose(np.eye(3), self._middle())
        self._gizmos = [self._add_gizmo(side, T) for side, T in zip(SIDES, self._Ts, strict=True)]
        self._between = self._add_gizmo("both", self._T_between)

    def open(self) -> None:
        """Open both hands, and let go of the clutch."""
        self._set_both(1.0)
        self._clutch.value = False

    def _set_both(self, opening: float) -> None:
        for slider in self._sliders:
            slider.value = opening

    def _add_gizmo(self, name: str, T: Array) -> Any:
        return self._server.scene.add_transform_controls(
            f"/lead/{self._placed_n}/{name}",
            scale=_HANDLE_SCALE,
            depth_test=False,
            wxyz=_wxyz(T),
            position=tuple(T[:3, 3]),
        )

    def read(self) -> HandReading:
        """Return where the handles are; values that are no numbers are ignored."""
        for hand, gizmo in enumerate(self._gizmos):
            T = _pose_of(gizmo)
            if T is not None:
                self._Ts[hand] = T
            opening = float(self._sliders[hand].value)
            if np.isfinite(opening):
                self._openings[hand] = min(max(opening, 0.0), 1.0)
        if self._between is not None:
            self._follow_between()
        left, right = self._openings
        return HandReading(
            (self._Ts[0].copy(), self._Ts[1].copy()),
            (left, right),
            bool(self._clutch.value),
            self._latency(),
        )

    def _follow_between(self) -> None:
        """Move both handles as the one between them was moved, or that one to their middle."""
        T = _pose_of(self._between)
        if T is not None and not np.allclose(T, self._T_between, atol=_STILL):
            T_moved = T @ np.linalg.inv(self._T_between)
            for hand, gizmo in enumerate(self._gizmos):
                self._Ts[hand] = T_moved @ self._Ts[hand]
                _put(gizmo, self._Ts[hand])
            self._T_between = T
        elif not np.allclose(self._middle(), self._T_between[:3, 3], atol=_STILL):
            self._T_between[:3, 3] = self._middle()
            _put(self._between, self._T_between)

    def _middle(self) -> Array:
        return 0.5 * (self._Ts[0][:3, 3] + self._Ts[1][:3, 3])


def _wxyz(T: Array) -> tuple[float, float, float, float]:
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    return float(w), float(x), float(y), float(z)


def _put(gizmo: Any, T: Array) -> None:
    gizmo.position = tuple(T[:3, 3])
    gizmo.wxyz = _wxyz(T)


def _pose_of(gizmo: Any) -> Array | None:
    """Return the pose (4, 4) of a gizmo; None if the page has sent no valid pose."""
    position = np.asarray(gizmo.position, dtype=float)
    w, x, y, z = np.asarray(gizmo.wxyz, dtype=float)
    quaternion = np.array([x, y, z, w])
    norm = float(np.linalg.norm(quaternion))
    if not np.isfinite(position).all() or not np.isfinite(norm) or norm <= 0.5:
        return None
    return pose(Rotation.from_quat(quaternion).as_matrix(), position)
