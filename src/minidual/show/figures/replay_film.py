"""Pictures of a replay: a film, or a sheet of frames with their times."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from minidual.config.scene import SceneConfig
from minidual.errors import unknown_name
from minidual.plant.model import build_model
from minidual.plant.render import Camera, Image, write_video
from minidual.plant.world import World

FILM_FPS = 25
FILM_SIZE = (640, 480)
CAMERAS = ("overview", "high", "left", "right")


class Postures:
    """A step hook that keeps the posture of everything at even times.

    Args:
        period_s: Simulated time between two of them [s].
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._next_s = -np.inf
        self.times: list[float] = []
        self.qpos: list[Any] = []

    def __call__(self, world: World) -> None:
        """Keep the present posture if it is due."""
        if world.time >= self._next_s - 1e-9:
            self._next_s = world.time + self._period_s
            self.times.append(world.time)
            self.qpos.append(world.data.qpos.copy())


def film_postures(scene: SceneConfig, postures: Postures, path: Path, *, camera: str = "overview") -> int:
    """Write the postures as an mp4 at FILM_FPS and return the number of frames."""
    return write_video(path, _pictures(scene, postures.qpos, camera), fps=FILM_FPS)


def sheet_of_postures(
    scene: SceneConfig, postures: Postures, path: Path, *, frames: int, camera: str = "overview"
) -> int:
    """Draw up to `frames` postures, evenly spread from first to last, into one png; return their number."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    chosen = np.unique(np.linspace(0, len(postures.times) - 1, frames).round().astype(int))
    columns = min(4, len(chosen))
    rows = -(-len(chosen) // columns)
    figure = Figure(figsize=(3.4 * columns, 2.75 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in grid:
        axes.set_axis_off()
    pictures = _pictures(scene, [postures.qpos[i] for i in chosen], camera)
    for axes, index, picture in zip(grid, chosen, pictures, strict=False):
        axes.imshow(picture)
        axes.set_title(f"{postures.times[index]:.3f} s", fontsize=10, loc="left")
    figure.savefig(path, dpi=120, metadata={"Software": None})
    return len(chosen)


def _pictures(scene: SceneConfig, qpos: list[Any], camera: str) -> Iterator[Image]:
    import mujoco  # not at the top: minidual.plant chooses its OpenGL platform first

    if camera not in CAMERAS:
        raise unknown_name("camera", camera, CAMERAS)
    model = build_model(scene, visuals=True)
    data = mujoco.MjData(model)
    with Camera(model, *FILM_SIZE, shadows=True) as eye:
        for posture in qpos:
            data.qpos[:] = posture
            mujoco.mj_forward(model, data)
            yield eye.picture(data, camera)
