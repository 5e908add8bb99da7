"""Browser view."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import viser

from minidual.config.view import ViewConfig
from minidual.show.view.network import free_port, is_loopback, tunnel_command, url
from minidual.show.view.overlay import Array, Overlay, Slider
from minidual.show.view.pace import Metronome, SpeedMeter
from minidual.show.view.panel import Panel
from minidual.show.view.scene import Scene

_PANEL_HZ = 6.0
_UNWATCHED = 10.0
"""Factor on the frame period without a connected browser."""
_FAREWELL_S = 0.3


class _Server(viser.ViserServer):
    """Viser server without public tunnels."""

    def request_share_url(self, verbose: bool = True) -> None:
        """Do nothing."""
        del verbose


@dataclass(frozen=True)
class _Frame:
    positions: Array
    quaternions: Array
    overlay: Overlay


class WebView:
    """See minidual.show.view.protocol.View.

    A thread sends the newest state, so slow clients do not delay the simulation. An error in it ends the view and is
    reported once.

    Raises:
        UsageError: Unusable interface, or no free port.
    """

    name = "web"

    def __init__(self, config: ViewConfig, say: Callable[[str], None]) -> None:
        self._say = say
        self.speed_max = config.speed_max
        port = free_port(config.host, config.port)
        with _quiet():
            self._server = _Server(host=config.host, port=port, label="minidual", verbose=False)
        self.port = self._server.get_port()
        self.url: str | None = url(config.host, self.port)
        self._panel = Panel(self._server)
        self._scene: Scene | None = None
        self._model: mujoco.MjModel | None = None
        self._metronome = Metronome(config.rate_hz)
        self._panel_metronome = Metronome(_PANEL_HZ)
        self._speed = SpeedMeter()
        self._slot: _Frame | None = None
        self._lock = threading.Lock()  # held while the scene is drawn or replaced
        self._wake = threading.Event()
        self._ending = False
        self._broken = False
        self._thread = threading.Thread(target=self._publish, name="minidual-view", daemon=True)
        self._thread.start()
        self._introduce(config)

    def _introduce(self, config: ViewConfig) -> None:
        if self.port != config.port:
            self._say(f"port {config.port} is taken; the view is at port {self.port}")
        self._say(f"view: {self.url}")
        if is_loopback(config.host):
            self._say(
                f"from another machine: {tunnel_command(self.port)}, then open http://127.0.0.1:{self.port} there"
            )
        else:
            self._say(
                f"warning: the view is bound to {config.host}: whoever reaches port {self.port} of this machine sees "
                "it and can move its sliders; there is no password"
            )

    @property
    def alive(self) -> bool:
        """Whether it is visible."""
        return not (self._ending or self._broken)

    @property
    def clients_n(self) -> int:
        """Number of connected browsers."""
        return len(self._server.get_clients())

    def open(self, model: mujoco.MjModel) -> None:
        """Show `model`."""
        if model is self._model or not self.alive:
            return
        with self._lock:
            self._slot = None
            self._scene = Scene(self._server, model)
            self._model = model

    def due(self) -> bool:
        """Return whether a new frame is due."""
        return self._metronome.due() and self._model is not None and self.alive

    def update(self, data: mujoco.MjData, overlay: Overlay) -> None:
        """Store a copy for the thread."""
        self._slot = _Frame(data.xpos.copy(), data.xquat.copy(), overlay)
        self._metronome.done(1.0 if self.clients_n else _UNWATCHED)
        self._wake.set()

    def offer(self, sliders: Sequence[Slider]) -> None:
        """Add sliders."""
        self._panel.offer(sliders)

    def slider_values(self) -> Array:
        """Return the slider values (n,)."""
        return self._panel.values()

    def _publish(self) -> None:
        try:
            while not self._ending:
                self._wake.wait()
                self._wake.clear()
                with self._lock:
                    frame, self._slot = self._slot, None
                    if frame is not None and self._scene is not None and not self._ending:
                        self._draw(self._scene, frame)
        except Exception as error:  # no error may reach the simulation
            self._broken = True
            self._say(f"the view ended early ({type(error).__name__}: {error}); what it showed goes on")

    def _draw(self, scene: Scene, frame: _Frame) -> None:
        speed = self._speed.add(frame.overlay.time_s)
        with self._server.atomic():
            scene.move(frame.positions, frame.quaternions)
            scene.draw_forces(frame.overlay.arrows)
        scene.draw_preview(frame.overlay.preview)
        if self._panel_metronome.due():
            self._panel.show(frame.overlay, speed)
            self._panel_metronome.done()

    def close(self) -> None:
        """Mark the page as ended; stop the server."""
        if self._ending:
            return
        last = self._slot
        self._ending = True
        self._wake.set()
        self._thread.join(timeout=2.0)
        with contextlib.suppress(Exception):  # the page also notices the closed connection
            overlay = last.overlay if last is not None else Overlay(np.nan)
            self._panel.show(replace(overlay, status="ended: the command has finished"), None)
            self._server.flush()
            if self.clients_n:
                threading.Event().wait(_FAREWELL_S)
        with _quiet():
            self._server.stop()


@contextlib.contextmanager
def _quiet() -> Generator[None]:
    """Keep viser off stdout, which carries data; `verbose` does not suffice."""
    import rich

    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
