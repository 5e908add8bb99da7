"""Films of trials and postures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import mujoco
import numpy as np

from minidual.config.scene import SceneConfig
from minidual.errors import unknown_name
from minidual.plant.model import build_model
from minidual.plant.render import Camera, Image, write_video
from minidual.plant.world import World
from minidual.robot.arms import DUAL_PANDA
from minidual.robot.pair import Array, Robot
from minidual.show.figures.canvas import sheet
from minidual.tasks.task import Trial
from minidual.trials.methods import Method, MethodInputs
from minidual.trials.runner import Bench, TrialResult

FILM_FPS = 25
FILM_SIZE = (640, 480)
CAMERAS = ("overview", "high", "left", "right")


def film_trial(method: str, inputs: MethodInputs, trial: Trial, path: Path) -> TrialResult:
    """Film a new run of `trial`; return that run's result."""
    bench = Bench(method, inputs, visuals=True)
    frames: list[Image] = []
    with Camera(bench.world.model, *FILM_SIZE, shadows=True) as camera:
        result, _ = bench.run(trial, on_step=film_hook(camera, frames))
    write_video(path, frames, fps=FILM_FPS)
    return result


def film_hook(camera: Camera, frames: list[Image], *, view: str = "overview") -> Callable[[World, Method], None]:
    """Return a step hook that collects frames at FILM_FPS."""

    def hook(world: World, method: Method) -> None:
        if world.time * FILM_FPS >= len(frames):
            frames.append(camera.picture(world.data, view))

    return hook


class Postures:
    """Step hook that samples qpos every `period_s` simulated seconds."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._next_s = -np.inf
        self.times: list[float] = []
        self.qpos: list[Array] = []

    def __call__(self, world: World) -> None:
        """Sample if due."""
        if world.time >= self._next_s - 1e-9:
            self._next_s = world.time + self._period_s
            self.times.append(world.time)
            self.qpos.append(world.data.qpos.copy())


def film_postures(
    scene: SceneConfig, postures: Postures, path: Path, *, camera: str = "overview", robot: Robot = DUAL_PANDA
) -> int:
    """Write an mp4; return the number of frames."""
    return write_video(path, _pictures(scene, robot, postures.qpos, camera), fps=FILM_FPS)


def sheet_of_postures(
    scene: SceneConfig,
    postures: Postures,
    path: Path,
    *,
    frames: int,
    camera: str = "overview",
    robot: Robot = DUAL_PANDA,
) -> int:
    """Draw up to `frames` evenly spaced postures."""
    chosen = np.unique(np.linspace(0, len(postures.times) - 1, frames).round().astype(int))
    pictures = _pictures(scene, robot, [postures.qpos[i] for i in chosen], camera)
    named = [(f"{postures.times[i]:.3f} s", picture.copy()) for i, picture in zip(chosen, pictures, strict=True)]
    sheet(named, min(4, len(named)), path)
    return len(named)


def _pictures(scene: SceneConfig, robot: Robot, qpos: Sequence[Array], camera: str) -> Iterator[Image]:
    if camera not in CAMERAS:
        raise unknown_name("camera", camera, CAMERAS)
    model = build_model(scene, robot, visuals=True)
    data = mujoco.MjData(model)
    with Camera(model, *FILM_SIZE, shadows=True) as eye:
        for posture in qpos:
            data.qpos[:] = posture
            mujoco.mj_forward(model, data)
            yield eye.picture(data, camera)
