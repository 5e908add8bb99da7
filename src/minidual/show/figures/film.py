"""Films of trials and postures."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import mujoco
import numpy as np

from minidual.demos.rig import Job, Rig
from minidual.plant.render import Image, write_video
from minidual.plant.simulation import Simulation
from minidual.robot.pair import Array
from minidual.show.figures.canvas import sheet
from minidual.show.figures.film_camera import FilmCamera
from minidual.show.figures.film_model import CAMERA, painted
from minidual.show.figures.side_by_side import film_takes, take
from minidual.tasks.failures import failure_words
from minidual.tasks.task import Trial
from minidual.trials.methods import MethodInputs
from minidual.trials.metrics import TrialMetrics
from minidual.trials.runner import Bench

FILM_FPS = 15
FILM_SIZE = (640, 360)
FAILURE_SIZE = (480, 360)
CAMERAS = ("overview", "high", "left", "right")
_AROUND_S = (-1.0, 0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Instants that are drawn, from the failure. Of those after it the last that is reached counts:
after the trial its condition is undone."""
_SHEET_COLUMNS_MAX = 4


def film_trial(method: str, inputs: MethodInputs, trial: Trial, path: Path) -> TrialMetrics:
    """Film a new run of `trial`, with captions; return that run's result."""
    shown = take(method, inputs, trial)
    film_takes([shown], path)
    return shown.result


def draw_failures(failed: Sequence[tuple[MethodInputs, Trial, TrialMetrics]], path: Path) -> None:
    """Run failed trials again and draw three pictures of each.

    They show the trial a second before it failed, when it failed, and a second later or at its end.
    """
    pictures: list[tuple[str, Image]] = []
    for inputs, trial, result in failed:
        pictures += _failure(inputs, trial, result)
    sheet(pictures, 3, path)


def _failure(inputs: MethodInputs, trial: Trial, result: TrialMetrics) -> list[tuple[str, Image]]:
    bench = Bench(result.method, inputs, result.condition)
    named_objects = (name for name in bench.task.objects if name in result.reason)
    shown_object = bench.world.truth(next(named_objects, bench.task.carried))
    images: list[Image] = []
    with ExitStack() as open_cameras:
        cameras: list[FilmCamera] = []

        def photograph(world: Simulation, _method: object) -> None:
            if not cameras:  # the condition has changed the world's model by now
                model = painted(world.scene, world.robot, world.model)
                camera = FilmCamera(model, FAILURE_SIZE)
                cameras.append(open_cameras.enter_context(camera))
            if len(images) == len(_AROUND_S):
                return
            due_s = result.failed_at_s + _AROUND_S[len(images)]
            if world.time >= due_s:
                position = shown_object.pose()[:3, 3]
                images.append(cameras[0].close_up(world.data.qpos, position).copy())

        bench.run(trial, on_step=photograph)
    before = images[0]
    at_failure = images[min(1, len(images) - 1)]
    after = images[-1]
    return [
        (f"{result.method}, {result.condition}, trial {result.index}", before),
        (f"{failure_words(result.failure)}, at {result.failed_at_s:.2f} s", at_failure),
        (result.reason, after),
    ]


def film_demonstration(job: Job, index: int, path: Path) -> None:
    """Lead trial `index` of a recording again and film it."""
    rig = Rig(job, ())
    postures = Postures(1.0 / FILM_FPS)
    trial = job.trial(index)
    rig.lead(trial, lambda _tick: postures(rig.world))
    rig.close()
    with rig.room(trial):
        model = painted(rig.world.scene, rig.world.robot, rig.world.model)
    film_postures(model, postures.qpos, path)


class Postures:
    """Step hook that samples qpos every `period_s` simulated seconds.

    Attributes:
        times: Of the samples [s].
        qpos: Samples (nq,).
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._next_s = -np.inf
        self.times: list[float] = []
        self.qpos: list[Array] = []

    def __call__(self, world: Simulation) -> None:
        """Sample if due."""
        if world.time >= self._next_s - 1e-9:
            self._next_s = world.time + self._period_s
            self.times.append(world.time)
            self.qpos.append(world.data.qpos.copy())


def film_postures(
    model: mujoco.MjModel,
    qpos: Sequence[Array],
    path: Path,
    *,
    camera: str = CAMERA,
    shadows: bool = True,
) -> int:
    """Write an mp4 of postures (nq,) of a film's model; return the number of frames."""
    return write_video(path, _pictures(model, qpos, camera, shadows=shadows), fps=FILM_FPS)


def sheet_of_postures(
    model: mujoco.MjModel,
    postures: Postures,
    path: Path,
    *,
    frames: int,
    camera: str = CAMERA,
) -> int:
    """Draw up to `frames` evenly spaced postures of a film's model; return their number."""
    evenly = np.linspace(0, len(postures.times) - 1, frames)
    frame_indices = np.unique(evenly.round().astype(int))
    pictures = _pictures(model, [postures.qpos[i] for i in frame_indices], camera, shadows=True)
    named = [
        (f"{postures.times[i]:.3f} s", picture.copy())
        for i, picture in zip(frame_indices, pictures, strict=True)
    ]
    sheet(named, min(_SHEET_COLUMNS_MAX, len(named)), path)
    return len(named)


def _pictures(
    model: mujoco.MjModel,
    qpos: Sequence[Array],
    camera: str,
    *,
    shadows: bool,
) -> Iterator[Image]:
    with FilmCamera(model, FILM_SIZE, shadows=shadows) as film_camera:
        for posture in qpos:
            yield film_camera.picture(posture, camera=camera)
