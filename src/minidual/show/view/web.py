"""Browser view."""

import contextlib
import errno
import getpass
import io
import socket
import time
from collections.abc import Callable

import mujoco
import viser

from minidual.config.root import ViewConfig
from minidual.errors import UsageError
from minidual.show.view.guard import Guard, is_loopback
from minidual.show.view.lead_page import LeadPage
from minidual.show.view.overlay import Overlay
from minidual.show.view.panel import Panel
from minidual.show.view.scene import Scene

_PORTS_N = 50
"""Ports that are tried, one after the other."""
_PANEL_PERIOD_S = 1.0 / 6.0
_UNWATCHED = 10.0
"""Factor of the frame period while no browser is connected."""
_FAREWELL_S = 0.3


class _Server(viser.ViserServer):
    def request_share_url(self, verbose: bool = True) -> None:
        """Do nothing."""


class WebView:
    """Shows a moving model in a browser, without changing the simulation.

    Call `open` once, then:

        if view.due():
            view.update(data, Overlay(data.time, mode="moveit"))

    `update` copies; it never waits for browsers. A drawing error is reported once and ends the view.

    Attributes:
        alive: Whether it is visible.
        panel: Beside the scene.
        port: Port of the server.
        speed_max: Largest simulated time over wall time; 0 for no limit.
        url: Address to open, with the token.

    Raises:
        UsageError: Unusable interface, or no free port.
        EnvironmentMissingError: A viser that cannot be guarded.
    """

    name = "web"

    def __init__(self, config: ViewConfig, say: Callable[[str], None]) -> None:
        self._config = config
        self._say = say
        self.speed_max = config.speed_max
        guard = Guard(config.host, config.remote_drives, say, config.origins)
        self._guard = guard
        port = free_port(config.host, config.port)
        with _quiet():
            self._server = guard.start(
                lambda: _Server(config.host, port, "minidual", verbose=False),
            )
        self.port = self._server.get_port()
        self.url: str | None = f"{url(config.host, self.port)}/?token={guard.token}"
        self._proxy_urls = [f"{origin}/?token={guard.token}" for origin in config.origins]
        self.alive = True
        self._closed = False
        self.panel = Panel(self._server)
        self._lead_page: LeadPage | None = None
        self._scene: Scene | None = None
        self._model: mujoco.MjModel | None = None
        self._overlay = Overlay()
        self._period_s = 1.0 / config.rate_hz
        self._frame_due_s = 0.0
        self._panel_due_s = 0.0

    def _introduce(self) -> None:
        """Say where the view is, and who can open it."""
        config = self._config
        if self.port != config.port:
            self._say(f"port {config.port} is taken; the view is at port {self.port}")
        self._say(f"view: {self.url}")
        for address in self._proxy_urls:
            self._say(f"through the proxy: {address}")
        if is_loopback(config.host):
            tunnel = tunnel_command(config.host, self.port)
            self._say(f"from another machine: {tunnel}, then open the same address there")
            return
        moves = "moves" if config.remote_drives else "cannot move"
        self._say(
            f"warning: the view is bound to {config.host}, without encryption: whoever has this "
            f"address, with the name of this machine, sees the view and {moves} its sliders",
        )
        if not config.remote_drives:
            self.panel.note("only pages on the machine that runs the command move the sliders")

    def open(self, model: mujoco.MjModel, *, rooms_n: int = 1) -> None:
        """Replace the shown model, which needs visual meshes; the first call says where the view is.

        Of a model with several rooms side by side, the camera stands back to see all.
        """
        if self._model is None:
            self._introduce()
        if model is not self._model and self.alive:
            self._scene = Scene(
                self._server,
                model,
                rooms_n=rooms_n,
                shadows=self._config.shadows,
            )
            self._model = model

    def lead_page(self) -> LeadPage:
        """Return the buttons and handles with which a person leads, added at the first call."""
        if self._lead_page is None:
            self._lead_page = LeadPage(self._server, lambda: self._guard.latency_s)
        return self._lead_page

    def due(self) -> bool:
        """Return whether a new frame is due."""
        return time.monotonic() >= self._frame_due_s and self._scene is not None and self.alive

    def update(self, data: mujoco.MjData, overlay: Overlay) -> None:
        """Show body poses, current as after mj_step or mj_kinematics."""
        if self._scene is None or not self.alive:
            return
        try:
            self._draw(self._scene, data, overlay)
        except Exception as error:  # no error may reach the simulation
            self.alive = False
            self._say(
                f"the view ended early ({type(error).__name__}: {error}); what it showed goes on",
            )

    def _draw(self, scene: Scene, data: mujoco.MjData, overlay: Overlay) -> None:
        with self._server.atomic():
            scene.move(data.xpos, data.xquat)
            scene.mark_goal(overlay.goal)
            scene.draw_forces(overlay.arrows)
        scene.draw_preview(overlay.preview)
        self._overlay = overlay
        now_s = time.monotonic()
        if now_s >= self._panel_due_s:
            self.panel.show(overlay)
            self._panel_due_s = now_s + _PANEL_PERIOD_S
        is_watched = bool(self._server.get_clients())
        self._frame_due_s = now_s + self._period_s * (1.0 if is_watched else _UNWATCHED)

    def close(self) -> None:
        """Mark the page as ended; stop the server."""
        if self._closed:
            return
        self._closed = True
        self.alive = False
        with contextlib.suppress(Exception):  # the page also notices the closed connection
            self.panel.show(self._overlay._replace(status="ended: the command has finished"))
            self._server.flush()
            if self._server.get_clients():
                time.sleep(_FAREWELL_S)
        with _quiet():
            self._server.stop()


def free_port(host: str, first: int, tries: int = _PORTS_N) -> int:
    """Return the first bindable port from `first` on.

    Raises:
        UsageError: Unusable interface, or no free port.
    """
    last = min(first + tries, 65536) - 1
    for port in range(first, last + 1):
        try:
            family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
            socket.create_server((host, port), family=family).close()
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                continue
            reason = error.strerror or error
            raise UsageError(
                f"the view cannot bind interface '{host}', port {port}: {reason}",
                remedy="--view-host 127.0.0.1 for this machine only, and a --view-port from 1024 up",
            ) from error
        return port
    raise UsageError(
        f"no free port for the view among {first} to {last}",
        remedy="end the program that holds them, or --view-port N",
    )


def url(host: str, port: int) -> str:
    """Return the address to open on this machine."""
    return f"http://{_reachable_name(host)}:{port}"


def _reachable_name(host: str) -> str:
    """Return the name of an interface in an address; for all interfaces, that of this machine."""
    if host == "0.0.0.0":
        return "127.0.0.1"
    if host == "::":
        return "[::1]"
    if ":" in host:
        return f"[{host}]"
    return host


def tunnel_command(host: str, port: int) -> str:
    """Return the ssh command for access to a loopback host from another machine."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container without a passwd entry for this user
        user = "user"
    return f"ssh -L {port}:{_reachable_name(host)}:{port} {user}@{socket.gethostname()}"


def _quiet() -> contextlib.redirect_stdout[io.StringIO]:
    """Keep viser off stdout, which carries data."""
    return contextlib.redirect_stdout(io.StringIO())
