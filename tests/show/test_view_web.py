"""The web view's server: who can reach it, what it survives, and that it changes nothing of what it shows."""

import socket
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import psutil
import pytest
from websockets.sync.client import connect

from minidual.config.root import Config, ViewConfig
from minidual.plant.world import World
from minidual.show.view import make_view
from minidual.show.view.overlay import Arrow, Overlay, PathLine, Preview, Slider
from minidual.show.view.web import WebView
from minidual.show.watch import Watcher, overlay, visual_model, watch_trials, watched
from minidual.tasks.catalogue import task_config
from minidual.trials.measures import TrialLog
from minidual.trials.methods import MethodInputs
from minidual.trials.metrics import TrialMetrics
from minidual.trials.runner import Bench, run_trials
from tests.support.browser import unused_port
from tests.support.carry_trials import sample_trial

CONFIG = Config()
SUBPROTOCOL = "viser-v1.1.1"


@pytest.fixture
def lines() -> list[str]:
    return []


@pytest.fixture
def view(lines: list[str]) -> Iterator[WebView]:
    made = make_view("web", ViewConfig(port=unused_port()), say=lines.append)
    assert isinstance(made, WebView)
    assert not lines  # the address is said when there is something to see
    made.open(visual_model(CONFIG.scene))
    yield made
    made.close()


def _socket(view: WebView) -> str:
    return str(view.url).replace("http:", "ws:")


def _show(view: WebView, world: World, **words: object) -> None:
    view.update(world.data, Overlay(world.time, **words))  # type: ignore[arg-type]


def _connects(host: str, port: int) -> bool:
    try:
        with socket.create_connection((host, port), timeout=2.0):
            return True
    except OSError:
        return False


def test_only_the_loopback_interface_answers(view: WebView, lines: list[str]) -> None:
    assert _connects("127.0.0.1", view.port)
    mine = {
        a.address
        for items in psutil.net_if_addrs().values()
        for a in items
        if a.family == socket.AF_INET
    }
    others = sorted((mine | {"127.0.0.2"}) - {"127.0.0.1"})  # every other address of this machine
    assert others
    assert not any(_connects(host, view.port) for host in others)
    assert any(f"view: http://127.0.0.1:{view.port}" in line for line in lines)
    assert any(f"ssh -L {view.port}:127.0.0.1:{view.port} " in line for line in lines)
    assert not any("warning" in line for line in lines)


def test_another_interface_must_be_asked_for_and_is_warned_of() -> None:
    said: list[str] = []
    view = make_view("web", ViewConfig(host="0.0.0.0", port=unused_port()), say=said.append)
    assert isinstance(view, WebView)
    try:
        view.open(visual_model(CONFIG.scene))
        assert _connects("127.0.0.2", view.port)  # the test above can fail
        assert any("warning: the view is bound to 0.0.0.0" in line for line in said)
    finally:
        view.close()


def test_page_and_socket_answer_and_the_port_is_free_afterwards(
    view: WebView,
    capfd: pytest.CaptureFixture[str],
) -> None:
    with urllib.request.urlopen(str(view.url), timeout=30) as answer:
        page = answer.read().decode()
    assert answer.status == 200
    assert "<script" in page
    with pytest.raises(urllib.error.HTTPError):
        urllib.request.urlopen(str(view.url).replace("/?", "/../../etc/passwd?"), timeout=30)
    with connect(_socket(view), subprotocols=[SUBPROTOCOL], max_size=None) as client:  # type: ignore[list-item]
        first = client.recv(timeout=30)
        assert isinstance(first, bytes)
        assert len(first) > 100
    view.close()
    view.close()
    assert not _connects("127.0.0.1", view.port)
    assert not view.alive
    assert capfd.readouterr().out == ""  # stdout is for data


def test_a_spare_connection_without_a_request_does_not_hold_up_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A browser opens one ahead of its next request; with the library's 10 s, Ctrl-C took 6 s."""
    monkeypatch.setattr("minidual.show.view.guard._OPEN_S", 0.2)
    view = make_view("web", ViewConfig(port=unused_port()), say=lambda _line: None)
    assert isinstance(view, WebView)
    with socket.create_connection(("127.0.0.1", view.port)):
        time.sleep(0.1)  # it is accepted
        began = time.monotonic()
        view.close()
        assert time.monotonic() - began < 3.0


def test_a_second_view_takes_the_next_port_and_says_so(view: WebView) -> None:
    said: list[str] = []
    other = make_view("web", ViewConfig(port=view.port), say=said.append)
    assert isinstance(other, WebView)
    other.open(visual_model(CONFIG.scene))
    other.close()
    assert other.port > view.port  # the very next one may belong to another program
    assert said[0] == f"port {view.port} is taken; the view is at port {other.port}"


def test_only_bodies_that_moved_are_sent(view: WebView) -> None:
    world = World(CONFIG.scene)
    view.open(visual_model(CONFIG.scene))
    scene = view._scene
    assert scene is not None
    _show(view, world)
    assert scene.move(world.data.xpos, world.data.xquat) == 0
    world.data.joint("left_panda_joint7").qpos[:] += 0.1
    mujoco.mj_kinematics(world.model, world.data)
    sent = scene.move(world.data.xpos, world.data.xquat)
    assert 1 <= sent <= 4  # the last link, the hand and its fingers
    frame = scene._frames[world.model.body("left_panda_link7").id]
    assert np.allclose(frame.position, world.data.body("left_panda_link7").xpos)
    assert np.allclose(frame.wxyz, world.data.body("left_panda_link7").xquat)


def test_forces_and_plans_are_drawn_and_taken_away(view: WebView) -> None:
    world = World(CONFIG.scene)
    model = visual_model(CONFIG.scene)
    view.open(model)
    scene = view._scene
    assert scene is not None
    line = PathLine("left", np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0.1]]), (1, 2, 3))
    ghost = world.data.qpos.copy()
    ghost[model.joint("left_panda_joint6").qposadr[0]] += 0.5
    preview = Preview((line,), (ghost,))
    arrows = (
        Arrow(np.zeros(3), np.array([0.0, 40.0, 0.0]), (1, 2, 3)),
        Arrow(np.ones(3), np.zeros(3), (1, 2, 3)),
    )
    _show(view, world, arrows=arrows, preview=preview, pinch_n=(1.0, 2.0), internal_n=3.0)
    assert view.alive
    assert scene._arrows.visible
    assert scene._arrows.points.shape == (1, 2, 3)  # no force, no arrow
    assert np.allclose(np.diff(scene._arrows.points[0], axis=0), [[0.0, 0.1, 0.0]])
    assert [node.name for node in scene._preview_nodes] == ["/plan/left", "/plan/ghost0"]
    _show(view, world)
    assert not scene._arrows.visible
    assert scene._preview_nodes == []


def test_what_breaks_in_the_view_is_said_once_and_stays_there(
    view: WebView,
    lines: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = World(CONFIG.scene)
    view.open(visual_model(CONFIG.scene))

    def broken(*_: object) -> int:
        raise OSError("the wire was cut")

    monkeypatch.setattr(view._scene, "move", broken)
    view.update(world.data, Overlay(0.0))
    assert not view.alive
    assert not view.due()
    view.update(world.data, Overlay(0.0))  # a caller that does not look is not punished
    assert sum("the wire was cut" in line for line in lines) == 1


def test_clients_that_vanish_do_not_hold_the_run_up(view: WebView) -> None:
    world = World(CONFIG.scene)
    clients = []
    with watched(view, world, Overlay):
        for k in range(600):
            world.step()
            if k % 150 == 0:
                clients.append(socket.create_connection(("127.0.0.1", view.port)))
                clients.append(
                    connect(_socket(view), subprotocols=[SUBPROTOCOL], max_size=None),  # type: ignore[list-item]
                )
            if k % 200 == 199:
                gone = clients.pop()
                (gone.socket if hasattr(gone, "socket") else gone).close()  # no farewell
    assert view.alive
    assert world.observer is None
    for client in clients:
        (client.socket if hasattr(client, "socket") else client).close()


def test_sliders_give_their_values(view: WebView) -> None:
    assert view.panel.values().shape == (0,)
    view.panel.offer([Slider("a", "x", -1.0, 1.0, 0.25), Slider("a", "y", 0.0, 1.0, 1.0)])
    assert view.panel.values().tolist() == [0.25, 1.0]
    view.panel._sliders[0][0].value = -0.5
    assert view.panel.values().tolist() == [-0.5, 1.0]
    for sent, kept in (
        (float("nan"), -0.5),
        (float("inf"), -0.5),
        (1e9, None),
    ):  # anybody can send anything
        view.panel._sliders[0][0].value = sent
        value = view.panel.values()[0]
        assert value == kept if kept is not None else value <= 10.0


def test_the_choice_is_the_button_pressed_last(view: WebView) -> None:
    view.panel.offer_choice("task", ["rod_carry", "pot_lift"])
    assert view.panel.choice == ""
    view.panel.choose("pot_lift")
    assert view.panel.choice == "pot_lift"


def test_no_one_can_open_a_public_tunnel(view: WebView) -> None:
    assert view._server.request_share_url() is None
    assert view._server._share_tunnel is None


def _keeping(run: Any, logs: list[TrialLog]) -> Any:
    def kept(*given: Any, **how: Any) -> tuple[TrialMetrics, TrialLog]:
        result, log = run(*given, **how)
        logs.append(log)
        return result, log

    return kept


def test_a_watched_trial_ends_as_an_unwatched_one_to_the_last_bit(
    view: WebView,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = CONFIG.scene.model_copy(
        update={"task": CONFIG.scene.task.model_copy(update={"time_limit_s": 1.5})},
    )
    config = CONFIG.model_copy(update={"scene": scene})
    inputs = MethodInputs(config, 5)
    trials = [sample_trial(scene, 5, "view-test", 0)]
    shown: list[Overlay] = []
    plain, log = Bench("impedance", inputs).run(trials[0])
    view._period_s = 0.001  # nobody is connected: a tenth of it is what is shown
    update = view.update
    view.update = lambda data, words: (shown.append(words), update(data, words))[1]  # type: ignore[method-assign]
    logs: list[TrialLog] = []
    monkeypatch.setattr(Bench, "run", _keeping(Bench.run, logs))
    (seen,) = run_trials("impedance", inputs, trials, workers=1, watch=watch_trials(view))
    assert len(shown) > 5
    assert shown[-1].title == "impedance, trial 1 of 1"
    assert seen == plain
    assert np.array_equal(log.q, logs[0].q)
    assert np.array_equal(log.tau, logs[0].tau)
    slower = sample_trial(
        scene,
        5,
        "view-test",
        1,
    )  # another start is another trial: the comparison can fail
    (other,) = run_trials("impedance", inputs, [slower], workers=1)
    assert other != plain


def test_between_pictures_a_step_pays_for_a_look_at_the_clock_only(view: WebView) -> None:
    world = World(CONFIG.scene)
    asked: list[int] = []
    watcher = Watcher(view, world, lambda: asked.append(1) or Overlay())  # type: ignore[func-returns-value]
    watcher(world)
    began = time.perf_counter()
    for _ in range(2000):
        watcher(world)
    spent = time.perf_counter() - began
    # Nobody is connected, so three pictures a second are taken.
    assert len(asked) <= 2 + spent * 4


def test_the_overlay_of_several_objects_is_of_all_of_them() -> None:
    config = Config().model_copy(update={"task": "insertion"})
    world = World(task_config(config).scene)
    words = overlay(world, Overlay(title="a title", mode="moveit", source="moveit", state="active"))
    assert len(world.objects) == 2
    assert words.pinch_n == (0.0, 0.0)


def test_the_overlay_says_what_the_world_says() -> None:
    world = World(CONFIG.scene)
    words = overlay(world, Overlay(title="a title", mode="moveit", source="moveit", state="active"))
    assert words.time_s == world.time
    assert words.pinch_n == tuple(world.truth().pinch())
    assert words.internal_n == world.truth().internal_force()
    assert (words.title, words.mode, words.source, words.state) == (
        "a title",
        "moveit",
        "moveit",
        "active",
    )


def test_the_green_mark_is_where_the_goal_of_the_trial_is(view: WebView) -> None:
    world = World(CONFIG.scene)
    view.update(world.data, overlay(world, Overlay()))
    np.testing.assert_allclose(view._scene._goal.position[:2], CONFIG.scene.task.goal_xy_m)
    world.mark_goal(0.53, -0.21, 0.2)
    view.update(world.data, overlay(world, Overlay()))
    np.testing.assert_allclose(view._scene._goal.position[:2], (0.53, -0.21))
    np.testing.assert_allclose(view._scene._goal.wxyz, (np.cos(0.1), 0, 0, np.sin(0.1)), atol=1e-9)


@pytest.mark.parametrize("shadows", [True, False])
def test_shadows_are_drawn_unless_they_are_switched_off(shadows: bool) -> None:
    config = ViewConfig(port=unused_port(), shadows=shadows)
    view = make_view("web", config, say=lambda _line: None)
    assert isinstance(view, WebView)
    try:
        view.open(visual_model(CONFIG.scene))
        light = view._server.scene._handle_from_node_name["/light/key"]
        assert light.cast_shadow == shadows
    finally:
        view.close()
