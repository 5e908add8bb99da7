"""Who may open the browser view, and what a page may send."""

import ipaddress
import logging
import re
import secrets
import socket
from collections.abc import Callable
from http import HTTPStatus
from typing import Any, Literal
from urllib.parse import parse_qs, urlsplit

import msgspec
import viser
from websockets.asyncio import server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response
from websockets.typing import Data, Subprotocol

from minidual.errors import EnvironmentMissingError

_MESSAGE_MAX_BYTES = 2**16
_OPEN_S = 2.0
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


_DECODER = msgspec.msgpack.Decoder(_Camera | _Change)


class _Connection(ServerConnection):
    """Drops messages that this page may not send."""

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

    A request needs the token, from the printed address or the cookie that the page sets, a Host that is this machine,
    and no Origin but its own Host. The moves of sliders count from this machine only, unless `remote_drives`.
    """

    def __init__(self, host: str, remote_drives: bool, say: Callable[[str], None]) -> None:
        self.token = secrets.token_urlsafe(24)
        self._host = host
        self._remote_drives = remote_drives
        self._say = say
        self._refused = False

    def start(self, make: Callable[[], viser.ViserServer]) -> viser.ViserServer:
        """Return the server that `make` starts, guarded.

        Raises:
            EnvironmentMissingError: viser did not call it; the server is stopped.
        """
        # viser takes no hooks for requests; the public `serve` of websockets, which it calls, does
        plain = websockets_server.serve
        hooked = False

        def serve(
            *arguments: Any,
            process_request: Any,
            **settings: Any,
        ) -> websockets_server.serve:
            nonlocal hooked
            hooked = True

            def answer(connection: _Connection, request: Request) -> Response | None:
                return self._answer(connection, request, process_request)

            settings |= {
                "process_request": answer,
                "create_connection": _Connection,
                "logger": _LOGGER,
            }
            # browsers keep a spare connection open without a request, and a server that stops waits for its timeout
            settings |= {
                "max_size": _MESSAGE_MAX_BYTES,
                "select_subprotocol": None,
                "open_timeout": _OPEN_S,
            }
            return plain(
                *arguments,
                **settings | {"subprotocols": [Subprotocol(f"viser-v{viser.__version__}")]},
            )

        websockets_server.serve = serve  # type: ignore[assignment, misc]
        try:
            made = make()
        finally:
            websockets_server.serve = plain
        if not hooked:
            made.stop()
            other = f"viser {viser.__version__} starts its server in another way, so the view cannot check who opens it"
            remedy = "install the version of viser in requirements.lock, or leave out --view web"
            raise EnvironmentMissingError(other, remedy=remedy)
        return made

    def _answer(
        self,
        connection: _Connection,
        request: Request,
        process_request: Any,
    ) -> Response | None:
        cookie = f"minidual-{connection.local_address[1]}"
        peer = str(connection.remote_address[0])
        if why := self._refusal(request, cookie):
            if not self._refused:
                self._say(
                    f"view: refused a request from {peer}: {why} (later ones are refused without a message)",
                )
            self._refused = True
            return connection.respond(HTTPStatus.FORBIDDEN, f"minidual: {why}\n")
        connection.drives = self._remote_drives or is_loopback(peer)
        response: Response | None = process_request(connection, request)
        if response is not None:
            response.headers["Set-Cookie"] = (
                f"{cookie}={self.token}; HttpOnly; SameSite=Strict; Path=/"
            )
            response.headers["Referrer-Policy"], response.headers["Cache-Control"] = (
                "no-referrer",
                "no-store",
            )
        return response

    def _refusal(self, request: Request, cookie: str) -> str:
        hosts = request.headers.get_all("Host")
        origins = request.headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_here(hosts[0]):
            return f"it asks for host {', '.join(hosts)[:80] or 'none'}, not for this machine"
        if origins not in ([], [f"http://{hosts[0]}"]):
            return f"it comes from a page of {', '.join(origins)[:80]}"
        given = parse_qs(request.path.partition("?")[2]).get("token", [])
        for kept in request.headers.get_all("Cookie"):
            given += re.findall(rf"(?:^|; *){cookie}=([^;]*)", kept)
        if not any(
            secrets.compare_digest(one.encode(errors="replace"), self.token.encode())
            for one in given
        ):
            return "it lacks the token of the address that this command printed"
        return ""

    def _is_here(self, host: str) -> bool:
        """Return whether a Host header names this machine; DNS may lend a stranger's page any other name."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if is_loopback(name) or is_loopback(self._host):
            return is_loopback(name)
        return bool(re.fullmatch(r"[\d.]+|.*:.*", name)) or name in (
            self._host,
            socket.gethostname(),
        )


def is_loopback(host: str) -> bool:
    """Return whether only this machine reaches `host`."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
