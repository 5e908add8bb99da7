"""Off-screen rendering and video."""

import os
import threading
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple, Self

import mujoco
import numpy as np
import numpy.typing as npt

from minidual.config.scene import CameraConfig
from minidual.durable import replacing
from minidual.errors import EnvironmentMissingError, UsageError, check_name
from minidual.plant.contact import GROUP_COLLISION
from minidual.variables import rendering_remedy

Image = npt.NDArray[np.uint8]


class StampedImage(NamedTuple):
    """An image (H, W, 3), and the simulated time [s] of the state that it shows."""

    image: Image
    stamp_s: float


_drawing_process: list[int] = []
"""The process that made the first OpenGL context here; a forked one inherits the note."""
_CLOSE_UP_M = 0.9
_CLOSE_UP_AZIMUTH_DEG = 150.0
_CLOSE_UP_ELEVATION_DEG = -25.0


def off_screen(
    model: mujoco.MjModel,
    width_px: int,
    height_px: int,
    **options: int,
) -> mujoco.Renderer:
    """Return a renderer; `options` are those of `mujoco.Renderer`.

    Raises:
        EnvironmentMissingError: There is no OpenGL.
        UsageError: This process was forked from one that had drawn.
    """
    if not _drawing_process:
        _drawing_process.append(os.getpid())
    _check_not_forked(_drawing_process[0])
    try:
        return mujoco.Renderer(model, height_px, width_px, **options)
    except Exception as error:  # GL backends raise various types
        raise EnvironmentMissingError(
            f"cannot create an off-screen OpenGL context by EGL: {error}",
            remedy=rendering_remedy(str(error)),
        ) from error


def _check_not_forked(process: int) -> None:
    """Raise UsageError in another process than the one that drew first.

    EGL's state does not survive a fork: the first picture would hang for ever.
    """
    if process == os.getpid():
        return
    raise UsageError(
        f"this process was forked from process {process}, which had drawn a picture:"
        " OpenGL by EGL would hang here",
        remedy='start worker processes with context="spawn", for example'
        ' gymnasium.vector.AsyncVectorEnv(makers, context="spawn"), or draw nothing before they'
        " start",
    )


def free_camera(
    at: npt.ArrayLike,
    distance_m: float,
    azimuth_deg: float,
    elevation_deg: float,
) -> mujoco.MjvCamera:
    """Return a camera that looks at a place (3,) [m]."""
    eye = mujoco.MjvCamera()
    eye.lookat = at
    eye.distance = distance_m
    eye.azimuth = azimuth_deg
    eye.elevation = elevation_deg
    return eye


class Camera(AbstractContextManager["Camera"]):
    """Renders images of one size, in the process and thread that made it; close it after use.

    `supersample` is the anti-aliasing factor.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        width_px: int,
        height_px: int,
        *,
        shadows: bool = False,
        supersample: int = 1,
    ) -> None:
        self._supersample = supersample
        self._process = os.getpid()
        self._thread = threading.current_thread()
        self._renderer = off_screen(model, width_px * supersample, height_px * supersample)
        self._option = mujoco.MjvOption()
        self._option.geomgroup[GROUP_COLLISION] = 0
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._renderer.scene.flags[flag] = int(shadows)
        self._model = model
        self._names = [model.camera(i).name for i in range(model.ncam)]

    @classmethod
    def recorded(cls, model: mujoco.MjModel, config: CameraConfig) -> Self:
        """Return the camera of recordings and policies."""
        return cls(model, config.width_px, config.height_px, supersample=config.supersample)

    def picture(
        self,
        data: mujoco.MjData,
        camera: str,
        decorate: Callable[[mujoco.MjvScene], None] | None = None,
    ) -> Image:
        """Return the image (H, W, 3) of `camera`; `decorate` may add geoms to what is drawn."""
        self._update(data, camera)
        if decorate is not None:
            decorate(self._renderer.scene)
        return _shrunk(self._renderer.render(), self._supersample)

    def stamped(self, data: mujoco.MjData, camera: str) -> StampedImage:
        """Return the image (H, W, 3) of `camera` with the time of the rendered state."""
        self._update(data, camera)
        # Rendering shows the state of the last update, whatever the clock says by then.
        stamp_s = data.time
        image = _shrunk(self._renderer.render(), self._supersample)
        return StampedImage(image, stamp_s)

    def close_up(self, data: mujoco.MjData, at: npt.ArrayLike) -> Image:
        """Return the image (H, W, 3) of a camera 0.9 m in front of a place (3,) [m]."""
        self._check_place()
        eye = free_camera(at, _CLOSE_UP_M, _CLOSE_UP_AZIMUTH_DEG, _CLOSE_UP_ELEVATION_DEG)
        self._renderer.update_scene(data, eye, scene_option=self._option)
        return self._renderer.render()

    def bodies_seen(self, data: mujoco.MjData, camera: str) -> dict[str, float]:
        """Return each visible body's share of the image."""
        self._check_place()
        self._renderer.enable_segmentation_rendering()
        try:
            self._update(data, camera)
            segments = self._renderer.render()
        finally:
            self._renderer.disable_segmentation_rendering()
        ids = segments[..., 0]
        is_geom = segments[..., 1] == int(mujoco.mjtObj.mjOBJ_GEOM)
        geoms, counts = np.unique(ids[is_geom], return_counts=True)
        shares: dict[str, float] = {}
        for geom, count in zip(geoms, counts, strict=True):
            body = self._model.body(int(self._model.geom_bodyid[geom])).name
            shares[body] = shares.get(body, 0.0) + int(count) / ids.size
        return shares

    def _check_place(self) -> None:
        """Raise UsageError in a forked process or another thread: an OpenGL context belongs to one."""
        _check_not_forked(self._process)
        thread = threading.current_thread()
        if thread is not self._thread:
            raise UsageError(
                f"a camera made in thread '{self._thread.name}' was used in '{thread.name}':"
                " an OpenGL context belongs to one thread",
                remedy="make a camera in each thread that draws",
            )

    def _update(self, data: mujoco.MjData, camera: str) -> None:
        self._check_place()
        check_name("camera", camera, self._names)
        self._renderer.update_scene(data, camera, scene_option=self._option)

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()

    def __exit__(self, *error: object) -> None:
        self.close()


def _shrunk(image: Image, factor: int) -> Image:
    """Return the means of squares of `factor` pixels.

    Sums of strided views take a tenth of the time of a mean over two axes.
    """
    total = np.zeros((image.shape[0] // factor, image.shape[1] // factor, 3), dtype=np.uint16)
    for row, column in np.ndindex(factor, factor):
        total += image[row::factor, column::factor]
    return (total // factor**2).astype(np.uint8)


def write_video(path: Path, frames: Iterable[Image], *, fps: int) -> int:
    """Write (H, W, 3) frames as H.264 mp4, atomically; return their number."""
    import av

    count = 0
    stream = None
    with replacing(path) as partial, av.open(str(partial), mode="w", format="mp4") as container:
        for frame in frames:
            count += 1
            if stream is None:
                options = {"crf": "24", "preset": "veryfast"}
                stream = container.add_stream("libx264", rate=Fraction(fps), options=options)
                stream.height, stream.width = frame.shape[:2]
                stream.pix_fmt = "yuv420p"
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
            container.mux(stream.encode(picture))
        if stream is not None:
            container.mux(stream.encode())
    return count
