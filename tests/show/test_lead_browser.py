"""A real browser leads with its mouse: start, drag both hands, success; an episode is recorded."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.root import Config, ViewConfig
from minidual.demos.attempt import Attempt
from minidual.demos.episode import read_episode
from minidual.demos.rig import Job, Rig
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array
from minidual.show.view import make_view
from minidual.show.view.scene import _CAMERA, _FOV_RAD, _TARGET
from minidual.show.view.web import WebView
from minidual.show.watch import watch_recording
from minidual.tasks.catalogue import make_task
from tests.support.browser import Browser, find_browser, unused_port

BROWSER = find_browser()
pytestmark = [
    pytest.mark.skipif(BROWSER is None, reason="no browser in PATH"),
    pytest.mark.timeout(600),  # drawn in software, on a busy machine
    pytest.mark.slow,
]
SIZE = (900, 560)


@pytest.fixture
def view() -> Iterator[WebView]:
    made = make_view("web", ViewConfig(port=unused_port(), rate_hz=4), say=lambda text: None)
    assert isinstance(made, WebView)
    yield made
    made.close()


def pixel_of(point: Array, rectangle: dict[str, float]) -> tuple[float, float]:
    """Return where the first camera of the view shows a point of the world."""
    eye = np.array(_CAMERA)
    ahead = np.array(_TARGET) - eye
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    away = point - eye
    scale = rectangle["height"] / (2.0 * np.tan(_FOV_RAD / 2.0)) / (away @ ahead)
    x = rectangle["x"] + rectangle["width"] / 2.0 + scale * (away @ right)
    y = rectangle["y"] + rectangle["height"] / 2.0 - scale * (away @ up)
    return float(x), float(y)


def rectangle_of(browser: Browser, expression: str) -> dict[str, float]:
    found: Any = browser.evaluate(
        f"(() => {{ const e = {expression}; if (!e) return null; "
        "const r = e.getBoundingClientRect(); "
        "return {x: r.x, y: r.y, width: r.width, height: r.height}; })()",
    )
    return found or {}


def mouse(browser: Browser, kind: str, x: float, y: float, buttons: int = 1) -> None:
    browser.call(
        "Input.dispatchMouseEvent",
        type=kind,
        x=x,
        y=y,
        button="left" if buttons or kind == "mouseReleased" else "none",
        buttons=buttons,
        clickCount=1,
    )


def click(browser: Browser, label: str) -> None:
    expression = f"[...document.querySelectorAll('button')].find(b => b.innerText == '{label}')"
    assert browser.until(lambda: bool(rectangle_of(browser, expression)), limit_s=60.0)
    browser.evaluate(f"({expression}).scrollIntoView({{block: 'center'}})")
    rectangle = rectangle_of(browser, expression)
    x = rectangle["x"] + rectangle["width"] / 2.0
    y = rectangle["y"] + rectangle["height"] / 2.0
    mouse(browser, "mouseMoved", x, y, buttons=0)
    mouse(browser, "mousePressed", x, y)
    mouse(browser, "mouseReleased", x, y, buttons=0)


def drag(browser: Browser, start: tuple[float, float], end: tuple[float, float]) -> None:
    mouse(browser, "mouseMoved", *start, buttons=0)
    mouse(browser, "mouseMoved", start[0] + 1.0, start[1], buttons=0)
    mouse(browser, "mousePressed", *start)
    for share in np.linspace(0.1, 1.0, 10):
        x = start[0] + share * (end[0] - start[0])
        y = start[1] + share * (end[1] - start[1])
        mouse(browser, "mouseMoved", x, y)
    mouse(browser, "mouseReleased", *end, buttons=0)


def test_a_person_leads_both_hands_with_the_mouse(view: WebView, tmp_path: Path) -> None:
    config = Config()
    teleop = config.teleop.model_copy(update={"leader": "browser", "cameras": ()})
    rig = Rig(Job(tmp_path, make_task(config), teleop, config.arbiter, 1), cameras=())
    rig.station = view.lead_page()
    watch = watch_recording(view)
    assert watch is not None
    attempts: list[Attempt] = []

    def record() -> None:
        with watch(rig, 0):
            attempts.append(rig.record(0))

    thread = threading.Thread(target=record, daemon=True)
    thread.start()
    handles = view.lead_page().handles()
    home = [T[:3, 3].copy() for T in Kinematics().tcp_poses(rig.job.robot.home)]
    with Browser(BROWSER, tmp_path / "profile", size=SIZE) as browser:
        browser.go(str(view.url))
        assert browser.until(lambda: "press start" in browser.text(), limit_s=120.0)
        click(browser, "Start")
        assert browser.until(lambda: "leading" in browser.text(), limit_s=60.0)
        canvas = rectangle_of(browser, "document.querySelector('canvas')")
        for hand, side in enumerate(SIDES):
            # The hand's z axis points down: the arrow is below it.
            start = pixel_of(home[hand] - (0.0, 0.0, 0.11), canvas)
            end = pixel_of(home[hand] - (0.0, 0.0, 0.19), canvas)
            drag(browser, start, end)
            moved = handles.read().Ts_world_tcp[hand][:3, 3] - home[hand]
            if moved[2] > -0.03:
                browser.picture(tmp_path / f"{side}.png")
            assert moved[2] == pytest.approx(-0.08, abs=0.04), f"{side}: {moved}"
        assert browser.until(lambda: bool(rig.world.time > 2.5), limit_s=120.0)
        click(browser, "Success")
        thread.join(120.0)
    rig.close()
    assert attempts, "the episode did not end"
    attempt = attempts[0]
    assert attempt.path is not None
    assert not attempt.kept
    assert "lifted" in attempt.reason or "rose" in attempt.reason or "not" in attempt.reason
    episode = read_episode(attempt.path, cameras=())
    last = Kinematics().tcp_poses(episode.qpos[-1])
    for hand in range(2):
        assert last[hand][2, 3] < home[hand][2] - 0.03
