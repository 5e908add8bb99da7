"""Access to the browser view, and checks of the messages of a page."""

import ipaddress
import logging
import re
import secrets
import socket
import weakref
from collections.abc import Callable, Sequence
from http import HTTPStatus
from typing import Any, Literal
from urllib.parse import parse_qs, urlsplit

import msgspec
import viser
from websockets.asyncio import server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response
from websockets.protocol import State
from websockets.typing import Data, Subprotocol

from minidual.errors import EnvironmentMissingError

_MESSAGE_MAX_BYTES = 2**16
_OPEN_S = 2.0
"""Browsers keep a spare connection open without a request; a server that stops waits for it."""
_PING_S = 1.0
"""Period in which the round trip to a page is measured."""
_IP_ADDRESS = re.compile(r"[\d.]+|.*:.*")
_FORWARDED = ("Forwarded", "X-Forwarded-For", "X-Forwarded-Host", "X-Real-IP", "Via")
"""Headers that proxies add."""
_LOGGER = logging.getLogger("minidual.view")
_LOGGER.addHandler(logging.NullHandler())
_LOGGER.propagate = False  # port probes would print tracebacks

_Numbers = tuple[float, ...]


class _Camera(msgspec.Struct, tag_field="type", tag="ViewerCameraMessage"):
    wxyz: _Numbers
    position: _Numbers
    look_at: _Numbers
    up_direction: _Numbers


class _Change(msgspec.Struct, tag_field="type", tag="GuiUpdateMessage"):
    """A slider or button. The server would set any attribute that a page names."""

    uuid: str
    updates: dict[Literal["value"], float | bool]


class _HandleMove(msgspec.Struct, tag_field="type", tag="TransformControlsUpdateMessage"):
    """A handle that a page drags."""

    name: str
    wxyz: tuple[float, float, float, float]
    position: tuple[float, float, float]
    owner: str


class _HandleTaken(msgspec.Struct, tag_field="type", tag="TransformControlsDragStartMessage"):
    name: str
    owner: str


class _HandleLeft(msgspec.Struct, tag_field="type", tag="TransformControlsDragEndMessage"):
    name: str
    owner: str


_DECODER = msgspec.msgpack.Decoder(_Camera | _Change | _HandleMove | _HandleTaken | _HandleLeft)


class _Connection(ServerConnection):
    """Drops messages that this page may not send.

    Attributes:
        drives: Whether the page may move sliders and press buttons.
    """

    drives = False

    async def recv(self, decode: bool | None = None) -> Data:
        """Return the next permitted message."""
        while True:
            raw = await super().recv(decode)
            try:
                message = _DECODER.decode(raw)  # type: ignore[arg-type]
            except (msgspec.MsgspecError, TypeError, ValueError, RecursionError):
                continue  # malformed, text, or of no use to the view
            if self.drives or isinstance(message, _Camera):
                return raw


class Guard:
    """Checks every request to a view at `host`; `say` gets the first refusal only.

    A request needs the token, from the printed address or the cookie that the page sets, a Host that
    is this machine, and no Origin but its own Host. With `origins` it may come through a proxy: its
    Origin or Host may be one of them. The moves of sliders count from this machine only, unless
    `remote_drives`; what comes through a proxy does not.
    """

    def __init__(
        self,
        host: str,
        remote_drives: bool,
        say: Callable[[str], None],
        origins: Sequence[str] = (),
    ) -> None:
        self.token = secrets.token_urlsafe(24)
        self._host = host
        self._remote_drives = remote_drives
        self._say = say
        self._origins = tuple(origins)
        self._refused = False
        self._connections: weakref.WeakSet[_Connection] = weakref.WeakSet()

    @property
    def latency_s(self) -> float | None:
        """Round trip to the slowest page that may move sliders; None without one."""
        latencies = [
            connection.latency
            for connection in list(self._connections)
            if connection.drives and connection.state is State.OPEN and connection.latency > 0.0
        ]
        return max(latencies, default=None)

    def start(self, make: Callable[[], viser.ViserServer]) -> viser.ViserServer:
        """Return the server that `make` starts, guarded.

        viser takes no hooks for requests. While it starts, the public `serve` of websockets, which it
        calls, is replaced by one that adds them.

        Raises:
            EnvironmentMissingError: viser did not call it; the server is stopped.
        """
        original_serve = websockets_server.serve
        was_called = False

        def guarded_serve(
            *arguments: Any,
            process_request: Any,
            **settings: Any,
        ) -> websockets_server.serve:
            nonlocal was_called
            was_called = True
            guarded = {**settings, **self._settings(process_request)}
            return original_serve(*arguments, **guarded)

        websockets_server.serve = guarded_serve  # type: ignore[assignment, misc]
        try:
            server = make()
        finally:
            websockets_server.serve = original_serve
        if not was_called:
            server.stop()
            raise EnvironmentMissingError(
                f"viser {viser.__version__} starts its server in another way, so the view cannot "
                "check who opens it",
                remedy="install the version of viser in requirements.lock, or leave out --view web",
            )
        return server

    def _settings(self, process_request: Any) -> dict[str, Any]:
        """Return the options of `serve` that replace viser's; `process_request` is viser's own."""

        def answer(connection: _Connection, request: Request) -> Response | None:
            return self._answer(connection, request, process_request)

        return {
            "process_request": answer,
            "create_connection": _Connection,
            "logger": _LOGGER,
            "max_size": _MESSAGE_MAX_BYTES,
            "select_subprotocol": None,
            "subprotocols": [Subprotocol(f"viser-v{viser.__version__}")],
            "open_timeout": _OPEN_S,
            "ping_interval": _PING_S,
        }

    def _answer(
        self,
        connection: _Connection,
        request: Request,
        process_request: Any,
    ) -> Response | None:
        cookie = f"minidual-{connection.local_address[1]}"
        peer = str(connection.remote_address[0])
        reason = self._refusal(request, cookie)
        if reason:
            if not self._refused:
                self._say(
                    f"view: refused a request from {peer}: {reason} "
                    "(later ones are refused without a message)",
                )
            self._refused = True
            return connection.respond(HTTPStatus.FORBIDDEN, f"minidual: {reason}\n")
        is_from_here = is_loopback(peer) and not self._is_proxied(request)
        connection.drives = self._remote_drives or is_from_here
        self._connections.add(connection)
        response: Response | None = process_request(connection, request)
        if response is not None:
            attributes = "HttpOnly; SameSite=Strict; Path=/"
            response.headers["Set-Cookie"] = f"{cookie}={self.token}; {attributes}"
            response.headers["Referrer-Policy"] = "no-referrer"
            response.headers["Cache-Control"] = "no-store"
        return response

    def _refusal(self, request: Request, cookie: str) -> str:
        """Return why a request is refused; empty if it is not."""
        hosts = request.headers.get_all("Host")
        proxy_hosts = [urlsplit(origin).netloc for origin in self._origins]
        if len(hosts) != 1 or not (hosts[0] in proxy_hosts or self._is_this_machine(hosts[0])):
            wanted = ", ".join(hosts)[:80] or "none"
            return f"it asks for host {wanted}, not for this machine or one of view.origins"
        origins = request.headers.get_all("Origin")
        own_origins = [] if hosts[0] in proxy_hosts else [f"http://{hosts[0]}"]
        if origins and (len(origins) > 1 or origins[0] not in (*own_origins, *self._origins)):
            return f"it comes from a page of {', '.join(origins)[:80]}, not of view.origins"
        if not any(self._is_token(text) for text in _tokens(request, cookie)):
            return "it lacks the token of the address that this command printed"
        return ""

    def _is_proxied(self, request: Request) -> bool:
        """Return whether a request came through a proxy, as far as it says so."""
        headers = request.headers
        if any(name in headers for name in _FORWARDED):
            return True
        hosts = [urlsplit(origin).netloc for origin in self._origins]
        return headers.get("Origin") in self._origins or headers.get("Host") in hosts

    def _is_token(self, text: str) -> bool:
        return secrets.compare_digest(text.encode(errors="replace"), self.token.encode())

    def _is_this_machine(self, host: str) -> bool:
        """Return whether a Host header names this machine.

        Names other than its own are refused: DNS may point a stranger's page at this machine.
        """
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if is_loopback(name) or is_loopback(self._host):
            return is_loopback(name)
        if _IP_ADDRESS.fullmatch(name):
            return True
        return name in (self._host, socket.gethostname())


def _tokens(request: Request, cookie: str) -> list[str]:
    """Return the tokens of a request, from its address and its cookies."""
    _, _, query = request.path.partition("?")
    tokens = parse_qs(query).get("token", [])
    for header in request.headers.get_all("Cookie"):
        tokens += re.findall(rf"(?:^|; *){cookie}=([^;]*)", header)
    return tokens


def is_loopback(host: str) -> bool:
    """Return whether only this machine reaches `host`."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
