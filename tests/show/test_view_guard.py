"""What a stranger may do with the web view: nothing without its token, and only look from another machine."""

import socket
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from urllib.parse import urlsplit

import msgspec
import mujoco
import numpy as np
import pytest
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from minidual.config.root import ViewConfig
from minidual.errors import EnvironmentMissingError, ExitCode
from minidual.show.view import guard, make_view, web
from minidual.show.view.overlay import Slider
from minidual.show.view.web import WebView
from tests.support.browser import CAMERA, unused_port

AWAY = "127.0.0.3"
"""Stands in for an address of another machine."""


def _view(**words: object) -> tuple[WebView, list[str]]:
    said: list[str] = []
    view = make_view("web", ViewConfig(port=unused_port(), **words), say=said.append)  # type: ignore[arg-type]
    assert isinstance(view, WebView)
    view.open(
        mujoco.MjModel.from_xml_string(
            "<mujoco><worldbody><geom size='0.1'/></worldbody></mujoco>"
        ),
    )
    view.panel.offer([Slider("a", "x", -1.0, 1.0, 0.25)])
    return view, said


@pytest.fixture
def shown() -> Iterator[tuple[WebView, list[str]]]:
    view, said = _view()
    yield view, said
    view.close()


def _token(view: WebView) -> str:
    return str(view.url).partition("token=")[2]


def _status(address: str, **headers: str) -> int:
    try:
        with urllib.request.urlopen(
            urllib.request.Request(address, headers=headers),
            timeout=30,
        ) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code


def _socket_status(address: str, headers: dict[str, str]) -> bytes:
    """Ask for a WebSocket with headers that the client library does not send."""
    where = urlsplit(address)
    asked = {
        "Host": where.netloc,
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
    }
    asked |= {
        "Sec-WebSocket-Key": f"{'A' * 22}==",
        "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
    } | headers
    lines = [
        f"GET {where.path}?{where.query} HTTP/1.1",
        *(f"{name}: {value}" for name, value in asked.items()),
    ]
    with socket.create_connection((where.hostname, where.port), timeout=30) as wire:
        wire.sendall("\r\n".join([*lines, "", ""]).encode())
        return wire.recv(12).split()[1]


def _connect(address: str, **words: object) -> ClientConnection:
    protocols = [Subprotocol(f"viser-v{viser.__version__}")]
    return connect(address.replace("http:", "ws:"), subprotocols=protocols, max_size=None, **words)  # type: ignore[arg-type]


def _move(view: WebView, client: ClientConnection, value: object, **more: object) -> None:
    """Send what the page sends when its slider moves."""
    message = {
        "type": "GuiUpdateMessage",
        "uuid": view.panel._sliders[0][0]._impl.uuid,
        "updates": {"value": value},
    }
    client.send(msgspec.msgpack.encode(message | more))


def _soon(holds: Callable[[], bool], limit_s: float = 20.0) -> bool:
    end = time.monotonic() + limit_s
    while not holds() and time.monotonic() < end:
        time.sleep(0.01)
    return holds()


def test_a_page_without_the_printed_address_is_refused_by_name(
    shown: tuple[WebView, list[str]],
) -> None:
    view, said = shown
    base = f"http://127.0.0.1:{view.port}/"
    token = _token(view)
    assert len(token) >= 32
    assert _status(str(view.url)) == 200
    assert _socket_status(str(view.url), {}) == b"101"
    assert said[2:] == []
    for address, headers in (
        (base, {}),
        (f"{base}?token=", {}),
        (f"{base}?token={token[:-1]}", {}),
        (f"{base}?token=%ff%00", {}),
        (base, {"Cookie": f"minidual-{view.port}=guess"}),
        (base, {"Cookie": f"minidual-1={token}"}),
        (str(view.url), {"Host": "evil.example"}),
        (str(view.url), {"Host": f"evil.example:{view.port}"}),  # DNS rebinding
        (str(view.url), {"Host": "127.0.0.1.evil.example"}),
        (str(view.url), {"Host": "192.0.2.1"}),
        (str(view.url), {"Host": "[127"}),
        (str(view.url), {"Host": ""}),
        (str(view.url), {"Origin": "http://evil.example"}),
        (str(view.url), {"Origin": "null"}),
        (
            str(view.url),
            {"Origin": f"http://127.0.0.1:{view.port + 1}"},
        ),  # another program's page on this machine
        (str(view.url), {"Origin": f"https://127.0.0.1:{view.port}"}),
    ):
        assert _status(address, **headers) == 403, (address, headers)
        assert _socket_status(address, headers) == b"403", (address, headers)
    assert len(said[2:]) == 1  # one line for all of them
    assert "lacks the token" in said[2]


def test_a_port_of_an_ssh_tunnel_and_the_cookie_are_as_good_as_the_address(
    shown: tuple[WebView, list[str]],
) -> None:
    view, said = shown
    base = f"http://127.0.0.1:{view.port}/"
    cookie = f"other=1; minidual-{view.port}={_token(view)}"
    for host in ("127.0.0.1:9000", "localhost:9000", "localhost", "[::1]:9000"):
        assert _status(str(view.url), Host=host, Origin=f"http://{host}") == 200
    with urllib.request.urlopen(str(view.url), timeout=30) as answer:
        assert answer.headers["Set-Cookie"].startswith(f"{cookie[9:]}; HttpOnly; SameSite=Strict")
        assert answer.headers["Referrer-Policy"] == "no-referrer"
    assert _status(base, Cookie=cookie) == 200
    own = Origin(f"http://127.0.0.1:{view.port}")
    with _connect(base, origin=own, additional_headers={"Cookie": cookie}) as client:
        _move(view, client, 0.5)
        assert _soon(lambda: view.panel.values()[0] == 0.5)
    assert said[2:] == []


def test_pages_on_other_machines_only_look_unless_they_are_allowed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = guard.is_loopback
    monkeypatch.setattr(guard, "is_loopback", lambda host: host != AWAY and real(host))
    for allowed in (False, True):
        view, said = _view(host="0.0.0.0", remote_drives=allowed)
        try:
            warning = next(line for line in said if line.startswith("warning"))
            assert ("cannot move" not in warning) == allowed
            with _connect(str(view.url), source_address=(AWAY, 0)) as client:
                client.send(msgspec.msgpack.encode(CAMERA))
                _move(view, client, 0.5)
                assert _soon(lambda view=view: bool(view._server.get_clients()))  # it sees
                client.send(msgspec.msgpack.encode(CAMERA))
                assert (
                    _soon(lambda view=view: view.panel.values()[0] == 0.5, 20.0 if allowed else 0.3)
                    == allowed
                )
            with _connect(str(view.url)) as client:  # this machine, and what comes through ssh
                _move(view, client, -0.75)
                assert _soon(lambda view=view: view.panel.values()[0] == -0.75)
            for host, code in (
                (socket.gethostname(), 200),
                ("192.0.2.1", 200),
                ("evil.example", 403),
            ):
                assert _status(str(view.url), Host=f"{host}:{view.port}") == code
            assert _status(f"http://127.0.0.1:{view.port}/", Host=f"127.0.0.1:{view.port}") == 403
        finally:
            view.close()


LAB = "https://lab.example.org"


def test_a_proxy_that_the_configuration_names_shows_the_view_and_moves_nothing() -> None:
    for allowed in (False, True):
        view, said = _view(origins=(LAB,), remote_drives=allowed)
        try:
            assert f"through the proxy: {LAB}/?token={_token(view)}" in said
            for headers in (
                {"Host": "lab.example.org", "Origin": LAB},
                {"Origin": LAB},  # a proxy that puts its own name for the view into Host
                {"X-Forwarded-For": "192.0.2.7"},
            ):
                assert _socket_status(str(view.url), headers) == b"101", headers
            for headers in (
                {"Host": "lab.example.org", "Origin": "http://lab.example.org"},
                {"Host": "evil.example", "Origin": LAB},
                {"Origin": "https://evil.example"},
                {"Origin": f"{LAB}.evil.example"},
            ):
                assert _socket_status(str(view.url), headers) == b"403", headers
            assert _status(f"http://127.0.0.1:{view.port}/", Origin=LAB) == 403  # no token
            with _connect(str(view.url), origin=Origin(LAB)) as client:
                _move(view, client, 0.5)
                limit_s = 20.0 if allowed else 0.3
                assert _soon(lambda view=view: view.panel.values()[0] == 0.5, limit_s) == allowed
            with _connect(str(view.url)) as client:  # this machine
                _move(view, client, -0.75)
                assert _soon(lambda view=view: view.panel.values()[0] == -0.75)
        finally:
            view.close()


def test_a_request_that_a_proxy_forwards_moves_nothing(
    shown: tuple[WebView, list[str]],
) -> None:
    view, _ = shown
    with _connect(str(view.url), additional_headers={"X-Forwarded-For": "192.0.2.7"}) as client:
        _move(view, client, 0.5)
        assert not _soon(lambda: view.panel.values()[0] == 0.5, 0.3)


@pytest.mark.parametrize("origin", ["lab.example.org", "https://lab.example.org/", "*", "file://x"])
def test_an_origin_is_scheme_host_and_port(origin: str) -> None:
    with pytest.raises(ValueError, match="origins"):
        ViewConfig(origins=(origin,))


def test_garbage_and_probes_are_one_line_at_most_and_change_nothing(
    shown: tuple[WebView, list[str]],
    capfd: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    view, said = shown
    rng = np.random.default_rng(7)
    for probe in (
        b"",
        b"\x16\x03\x01\x02\x00\x01\x00",
        b"SSH-2.0-x\r\n",
        b"HEAD / HTTP/1.0\r\n\r\n",
        b"GET /\r\n" * 9,
    ):
        with socket.create_connection(("127.0.0.1", view.port), timeout=30) as wire:
            wire.sendall(probe)
    for _ in range(10):
        with socket.create_connection(("127.0.0.1", view.port), timeout=30) as wire:
            wire.sendall(rng.bytes(300))
    uuid = view.panel._sliders[0][0]._impl.uuid
    change = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": 0.9}}
    wrong = [
        change | {"updates": {"value": "<script>"}},
        change | {"updates": {"value": [0.9]}},
        change | {"updates": {"removed": True}},
        change | {"updates": {"value": 0.9, "update_cb": 1.0}},
        change | {"updates": 3},
        change | {"uuid": ["x"]},
        change | {"type": "Message"},
        change | {"more": 1},
        {"type": "ShareUrlRequest"},
        {"type": "GuiButtonHoldMessage", "uuid": uuid, "frequency": 1.0},
        {"type": "FileTransferStartUpload", "source_component_uuid": uuid, "size_bytes": 2**40},
        CAMERA | {"wxyz": "x"},
        CAMERA | {"position": [[1], [2, 3]]},
        {"type": "ViewerCameraMessage"},
        [1, 2, 3],
    ]
    frames: list[bytes | str] = [msgspec.msgpack.encode(one) for one in wrong]
    frames += ["text", b"", b"\x91" * 5000, b"\xdf\xff\xff\xff\xff", bytes(2**17)]
    frames += [rng.bytes(int(rng.integers(1, 80))) for _ in range(40)]
    for frame in frames:
        with _connect(str(view.url)) as client:
            client.send(frame)
            try:
                _move(view, client, "end")
            except ConnectionClosed:  # too long a frame
                assert len(frame) > 2**16
    assert view.panel.values()[0] == 0.25
    with _connect(str(view.url)) as client:
        _move(view, client, 0.5)
        assert _soon(lambda: view.panel.values()[0] == 0.5)
    assert view.panel._sliders[0][0]._impl.removed is False
    shown_text = capfd.readouterr()
    assert (shown_text.out, shown_text.err) == ("", "")
    assert {record.name for record in caplog.records if record.levelname != "DEBUG"} <= {
        guard._LOGGER.name,
    }
    assert len(said[2:]) <= 1


def test_what_the_terminal_shows_of_a_refusal_is_short(shown: tuple[WebView, list[str]]) -> None:
    view, said = shown
    assert _status(str(view.url), Origin="http://" + 5000 * "x") == 403
    assert "it comes from a page of http://xxx" in said[2]
    assert len(said[2]) < 250


def test_a_viser_that_starts_its_server_in_another_way_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stopped: list[str] = []

    class Other:
        def __init__(self, *_: object, **__: object) -> None:
            pass

        def stop(self) -> None:
            stopped.append("stopped")

    monkeypatch.setattr(web, "_Server", Other)
    with pytest.raises(
        EnvironmentMissingError,
        match="the view cannot check who opens it",
    ) as caught:
        _view()
    assert caught.value.exit_code == ExitCode.ENVIRONMENT
    assert stopped == ["stopped"]
    assert guard.websockets_server.serve.__module__.startswith("websockets")
