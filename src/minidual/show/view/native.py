"""The view in MuJoCo's own window."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from minidual.config.view import ViewConfig
from minidual.errors import EnvironmentMissingError
from minidual.show.view.overlay import Array, Arrow, Overlay, PathLine, Slider
from minidual.show.view.pace import Metronome, SpeedMeter
from minidual.show.view.web_scene import ARROW_M_PER_N, ARROW_MIN_N

_REMEDY = "--view web needs no display: open its address in a browser, here or through an ssh tunnel"


class NativeView:
    """See minidual.show.view.protocol.View. The window has a state of its own: pushing bodies in it pushes a copy.

    Raises:
        EnvironmentMissingError: There is no display to open a window on.
    """

    name = "native"
    url: str | None = None

    def __init__(self, config: ViewConfig, say: Callable[[str], None]) -> None:
        if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise EnvironmentMissingError(
                "--view native opens a window, and there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set)",
                remedy=_REMEDY,
            )
        self._say = say
        self._metronome = Metronome(config.rate_hz)
        self._speed = SpeedMeter()
        self._model: mujoco.MjModel | None = None
        self._data: mujoco.MjData | None = None
        self._handle: mujoco.viewer.Handle | None = None
        self._ended = False

    @property
    def alive(self) -> bool:
        """Whether the window is open, or still to be opened."""
        return not self._ended and (self._handle is None or bool(self._handle.is_running()))

    def open(self, model: mujoco.MjModel) -> None:
        """Open the window on `model`; another model needs another window."""
        if model is self._model or not self.alive:
            return
        import mujoco.viewer

        if self._handle is not None:
            self._handle.close()
        self._model, self._data = model, mujoco.MjData(model)
        try:
            self._handle = mujoco.viewer.launch_passive(model, self._data, show_left_ui=False, show_right_ui=False)
        except Exception as error:  # the window libraries raise whatever they like
            raise EnvironmentMissingError(f"no window could be opened: {error}", remedy=_REMEDY) from error
        camera = self._handle.cam
        camera.lookat[:] = (0.30, -0.02, 0.20)
        camera.distance, camera.azimuth, camera.elevation = 1.9, 145.0, -22.0

    def due(self) -> bool:
        """Return whether a new picture is wanted."""
        return self._metronome.due() and self._handle is not None and self.alive

    def update(self, data: mujoco.MjData, overlay: Overlay) -> None:
        """Copy the state into the window's own."""
        handle, model, own = self._handle, self._model, self._data
        if handle is None or model is None or own is None:
            return
        with handle.lock():
            own.qpos[:] = data.qpos
            own.time = data.time
            mujoco.mj_kinematics(model, own)
            mujoco.mj_camlight(model, own)
            _draw(handle.user_scn, overlay.arrows, overlay.preview.paths)
        handle.set_texts(_texts(overlay, self._speed.add(overlay.time_s)))
        handle.sync()
        self._metronome.done()

    def offer(self, sliders: Sequence[Slider]) -> bool:
        """Return False: this window has no sliders of ours."""
        del sliders
        return False

    def slider_values(self) -> Array:
        """Return (0,)."""
        return np.empty(0)

    def close(self) -> None:
        """Close the window."""
        if not self._ended and self._handle is not None:
            self._handle.close()
        self._ended = True


def _texts(overlay: Overlay, speed: float | None) -> tuple[int | None, int | None, str, str]:
    """Return the text in the window's corner: names in one column, values in the other."""
    rows = [
        ("", overlay.title),
        ("mode", overlay.mode),
        ("source", overlay.source),
        ("state", overlay.state),
        ("time", f"{overlay.time_s:.2f} s"),
        ("speed", "" if speed is None else f"{speed:.2f} x"),
        ("pinch", "" if overlay.pinch_n is None else "{:.1f} / {:.1f} N".format(*overlay.pinch_n)),
        ("squeeze", "" if overlay.internal_n is None else f"{overlay.internal_n:.1f} N"),
        ("", overlay.status),
    ]
    shown = [(name, value) for name, value in rows if value]
    return None, None, "\n".join(name for name, _ in shown), "\n".join(value for _, value in shown)


def _draw(scene: mujoco.MjvScene, arrows: Sequence[Arrow], paths: Sequence[PathLine]) -> None:
    """Fill the window's own scene with arrows and lines, as many as it holds."""
    shapes = [
        (mujoco.mjtGeom.mjGEOM_ARROW, 0.008, a.start, a.start + ARROW_M_PER_N * a.force, a.rgb)
        for a in arrows
        if float(np.linalg.norm(a.force)) >= ARROW_MIN_N
    ]
    shapes += [
        (mujoco.mjtGeom.mjGEOM_CAPSULE, 0.003, first, second, line.rgb)
        for line in paths
        for first, second in zip(line.points[:-1], line.points[1:], strict=True)
    ]
    count = min(len(shapes), scene.maxgeom)
    for geom, (kind, width, first, second, rgb) in zip(scene.geoms[:count], shapes[:count], strict=True):
        rgba = np.array([*(c / 255.0 for c in rgb), 1.0], dtype=np.float32)
        mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba)
        mujoco.mjv_connector(geom, kind, width, np.asarray(first, float), np.asarray(second, float))
    scene.ngeom = count
