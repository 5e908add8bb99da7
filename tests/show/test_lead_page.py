"""What a page sends moves the handles and presses the buttons of the person who leads."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import msgspec
import numpy as np
import pytest
import viser
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from minidual.config.learning import TeleopConfig
from minidual.config.root import ViewConfig
from minidual.demos.leader import Feedback, LeaderSetup
from minidual.demos.leaders.browser import BrowserLeader
from minidual.demos.station import NO_STATION, PAUSED, Button, Status
from minidual.errors import EnvironmentMissingError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.show.view import make_view
from minidual.show.view.lead_page import LeadPage, status_html
from minidual.show.view.web import WebView
from tests.support.browser import CAMERA, unused_port
from tests.support.carry_trials import carry_task, sample_trial

HOME = DUAL_PANDA.home


@pytest.fixture
def view() -> Iterator[WebView]:
    made = make_view("web", ViewConfig(port=unused_port()), say=lambda text: None)
    assert isinstance(made, WebView)
    yield made
    made.close()


@pytest.fixture
def page(view: WebView) -> Iterator[ClientConnection]:
    address = str(view.url).replace("http:", "ws:")
    protocols = [Subprotocol(f"viser-v{viser.__version__}")]
    with connect(address, subprotocols=protocols, max_size=None) as client:
        client.send(msgspec.msgpack.encode(CAMERA))
        until(lambda: bool(view._server.get_clients()))
        yield client


@pytest.fixture
def leader(view: WebView, scene: Any) -> BrowserLeader:
    task = carry_task(scene)
    setup = LeaderSetup(DUAL_PANDA, task, TeleopConfig(), 1, view.lead_page())
    made = BrowserLeader.connect(setup)
    made.align(sample_trial(scene, 1, "demonstrations", 0), HOME)
    return made


def until(holds: Callable[[], bool], limit_s: float = 10.0) -> None:
    end_s = time.monotonic() + limit_s
    while not holds():
        assert time.monotonic() < end_s, "it did not happen in time"
        time.sleep(0.01)


def send(page: ClientConnection, **message: Any) -> None:
    page.send(msgspec.msgpack.encode(message))


def drag(
    page: ClientConnection,
    side: str,
    position: Sequence[float],
    wxyz: Sequence[float] = (0.0, 1.0, 0.0, 0.0),
) -> None:
    for kind in ("DragStart", "Update", "DragEnd"):
        message: dict[str, Any] = {
            "type": f"TransformControls{kind}Message",
            "name": f"/lead/1/{side}",
            "owner": "",
        }
        if kind == "Update":
            message |= {"wxyz": list(wxyz), "position": [float(x) for x in position]}
        send(page, **message)


def left_hand(leader: BrowserLeader) -> np.ndarray:
    sample = leader.read(0.0)
    assert sample is not None
    assert sample.Ts_world_tcp is not None
    return sample.Ts_world_tcp[0]


def test_the_pause_button_says_what_it_does(view: WebView) -> None:
    page = view.lead_page()
    labels = []
    for state in ("leading", PAUSED, "leading"):
        page._shown_at_s = -math.inf  # shown at once
        page.show(Status(state))
        labels.append(page._buttons[Button.PAUSE].label)
    assert labels == ["Pause", "Go on", "Pause"]


def test_the_handles_begin_at_the_hands(leader: BrowserLeader) -> None:
    sample = leader.read(0.0)
    assert sample is not None
    assert sample.Ts_world_tcp is not None
    np.testing.assert_allclose(sample.Ts_world_tcp, Kinematics().tcp_poses(HOME), atol=1e-6)
    np.testing.assert_array_equal(sample.openings, [1.0, 1.0])


def test_a_dragged_handle_is_where_the_hand_is_to_go(
    leader: BrowserLeader,
    page: ClientConnection,
) -> None:
    drag(page, "left", (0.4, 0.2, 0.3))
    until(lambda: bool(np.allclose(left_hand(leader)[:3, 3], (0.4, 0.2, 0.3))))
    np.testing.assert_allclose(left_hand(leader)[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-6)


def test_the_handle_between_the_hands_moves_both(
    leader: BrowserLeader,
    page: ClientConnection,
) -> None:
    home = Kinematics().tcp_poses(HOME)
    middle = 0.5 * (home[0][:3, 3] + home[1][:3, 3])
    raised = middle + np.array([0.0, 0.0, 0.05])
    drag(page, "both", tuple(raised), wxyz=[1.0, 0.0, 0.0, 0.0])
    until(lambda: bool(np.isclose(left_hand(leader)[2, 3], home[0][2, 3] + 0.05)))
    sample = leader.read(0.0)
    assert sample is not None
    assert sample.Ts_world_tcp is not None
    for T, T_home in zip(sample.Ts_world_tcp, home, strict=True):
        np.testing.assert_allclose(T[:3, 3], T_home[:3, 3] + (0.0, 0.0, 0.05), atol=1e-6)
        np.testing.assert_allclose(T[:3, :3], T_home[:3, :3], atol=1e-6)
    quarter = math.sqrt(0.5)
    drag(page, "both", tuple(raised), wxyz=[quarter, 0.0, 0.0, quarter])
    x, y, _ = home[0][:3, 3] - middle
    turned = raised + np.array([-y, x, home[0][2, 3] - middle[2]])
    until(lambda: bool(np.allclose(left_hand(leader)[:3, 3], turned, atol=1e-6)))
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(left_hand(leader)[:3, :3], R @ home[0][:3, :3], atol=1e-6)


def test_the_handle_between_the_hands_stays_between_them(
    leader: BrowserLeader,
    view: WebView,
    page: ClientConnection,
) -> None:
    home = Kinematics().tcp_poses(HOME)
    moved = home[0][:3, 3] + (0.0, 0.1, 0.02)
    drag(page, "left", tuple(moved))
    until(lambda: bool(np.allclose(left_hand(leader)[:3, 3], moved)))
    between = view.lead_page().handles()._between
    middle = 0.5 * (moved + home[1][:3, 3])
    np.testing.assert_allclose(between.position, middle, atol=1e-6)
    sample = leader.read(0.0)
    assert sample is not None
    assert sample.Ts_world_tcp is not None
    np.testing.assert_allclose(sample.Ts_world_tcp[1], home[1], atol=1e-6)


def test_a_handle_of_no_number_is_ignored(leader: BrowserLeader, page: ClientConnection) -> None:
    drag(page, "left", (math.nan, 0.2, 0.3))
    drag(page, "right", (0.4, -0.2, 0.3))
    sample = leader.read(0.0)
    assert sample is not None

    def right_moved() -> bool:
        reading = leader.read(0.0)
        assert reading is not None
        assert reading.Ts_world_tcp is not None
        return bool(np.allclose(reading.Ts_world_tcp[1][:3, 3], (0.4, -0.2, 0.3)))

    until(right_moved)
    np.testing.assert_allclose(left_hand(leader), Kinematics().tcp_poses(HOME)[0], atol=1e-6)


def test_a_drag_of_handles_that_were_replaced_moves_nothing(
    leader: BrowserLeader,
    page: ClientConnection,
    scene: Any,
) -> None:
    home = Kinematics().tcp_poses(HOME)
    drag(page, "both", (0.3, 0.1, 0.4), wxyz=[0.0, 0.0, 1.0, 0.0])
    until(lambda: not np.allclose(left_hand(leader), home[0], atol=1e-6))
    leader.align(sample_trial(scene, 1, "demonstrations", 1), HOME)  # while the mouse is down
    drag(page, "both", (0.3, 0.2, 0.4), wxyz=[0.0, 0.0, 1.0, 0.0])
    time.sleep(0.5)
    np.testing.assert_allclose(left_hand(leader), home[0], atol=1e-6)


def test_buttons_and_sliders_of_the_page_count(
    leader: BrowserLeader,
    view: WebView,
    page: ClientConnection,
) -> None:
    lead = view.lead_page()
    pressed: list[Button] = []
    for button in Button:
        handle = lead._buttons[button]
        send(page, type="GuiUpdateMessage", uuid=handle._impl.uuid, updates={"value": True})
    slider = lead.handles()._sliders[1]
    send(page, type="GuiUpdateMessage", uuid=slider._impl.uuid, updates={"value": 0.25})

    def all_came() -> bool:
        pressed.extend(lead.pressed())
        return len(pressed) == len(Button)

    until(all_came)
    assert set(pressed) == set(Button)
    sample = leader.read(0.0)
    assert sample is not None
    np.testing.assert_array_equal(sample.openings, [1.0, 0.25])


def test_one_click_closes_or_opens_both_hands(
    leader: BrowserLeader,
    view: WebView,
    page: ClientConnection,
) -> None:
    handles = view.lead_page().handles()

    def openings() -> list[float]:
        sample = leader.read(0.0)
        assert sample is not None
        return sample.openings.tolist()

    for button, opening in ((handles._close, 0.0), (handles._open, 1.0), (handles._close, 0.0)):
        expected = [opening] * 2
        send(page, type="GuiUpdateMessage", uuid=button._impl.uuid, updates={"value": True})
        until(lambda expected=expected: openings() == expected)


def test_released_from_the_clutch_the_handles_return_to_the_hands(
    leader: BrowserLeader,
    view: WebView,
    page: ClientConnection,
) -> None:
    clutch = view.lead_page().handles()._clutch
    clutch.value = True
    drag(page, "left", (0.6, 0.1, 0.4))
    until(lambda: bool(np.allclose(left_hand(leader)[:3, 3], (0.6, 0.1, 0.4))))
    sample = leader.read(0.0)
    assert sample is not None
    assert sample.clutch
    clutch.value = False
    np.testing.assert_allclose(left_hand(leader), Kinematics().tcp_poses(HOME)[0], atol=1e-6)


def test_a_person_sees_how_high_the_finger_tips_are(leader: BrowserLeader) -> None:
    q = HOME.copy()
    q[1] += 0.1
    left, right = (1e3 * T[2, 3] for T in Kinematics().tcp_poses(q))
    leader.feedback(Feedback(0.1, q, np.ones(2), np.zeros(14)))
    assert leader.hint == f"finger tips above the table: left {left:.0f} mm, right {right:.0f} mm"
    assert left < right - 10.0


def test_the_round_trip_to_the_page_is_measured(
    leader: BrowserLeader,
    view: WebView,
    page: ClientConnection,
) -> None:
    def is_known() -> bool:
        sample = leader.read(0.0)
        return sample is not None and sample.age_s is not None

    until(is_known)
    latency_s = view._guard.latency_s
    assert latency_s is not None
    assert 0.0 < latency_s < 5.0


def test_a_person_sees_time_left_latency_and_why_the_arms_hold() -> None:
    status = Status(
        "leading", 41.6, "left hand: out of reach", "<b> away", 0.0123, "trial 3 was kept"
    )
    shown = status_html(status)
    assert "time left 42 s" in shown
    assert "latency 12 ms" in shown
    assert "the arms hold: &lt;b&gt; away" in shown
    assert "left hand: out of reach" in shown
    assert "trial 3 was kept" in shown


def test_without_a_view_there_is_nothing_to_drag(scene: Any) -> None:
    setup = LeaderSetup(DUAL_PANDA, carry_task(scene), TeleopConfig(), 1, NO_STATION)
    with pytest.raises(EnvironmentMissingError, match="needs the live view"):
        BrowserLeader.connect(setup)


def test_the_page_is_made_once(view: WebView) -> None:
    page = view.lead_page()
    assert isinstance(page, LeadPage)
    assert view.lead_page() is page
    assert page.handles() is page.handles()
