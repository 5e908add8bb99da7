"""Films of trials and postures."""

import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path

import mujoco
import numpy as np

from minidual.demos.rig import Job, Rig
from minidual.plant.render import Camera, Image, write_video
from minidual.plant.world import World
from minidual.robot.pair import Array
from minidual.show.figures.canvas import sheet
from minidual.tasks.task import Trial
from minidual.trials.methods import MethodInputs
from minidual.trials.metrics import TrialMetrics
from minidual.trials.runner import Bench

FILM_FPS = 25
FILM_SIZE = (640, 480)
FAILURE_SIZE = (400, 300)
CAMERAS = ("overview", "high", "left", "right")
_AROUND_S = (-1.0, 0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Instants that are drawn, from the failure. Of those after it the last that is reached counts:
after the trial its condition is undone."""
_SHEET_COLUMNS_MAX = 4


def film_trial(method: str, inputs: MethodInputs, trial: Trial, path: Path) -> TrialMetrics:
    """Film a new run of `trial`; return that run's result."""
    bench = Bench(method, inputs, visuals=True)
    postures = Postures(1.0 / FILM_FPS)

    def sample(world: World, _method: object) -> None:
        postures(world)

    result, _ = bench.run(trial, on_step=sample)
    film_postures(bench.world.model, postures.qpos, path)
    return result


def draw_failures(failed: Sequence[tuple[MethodInputs, Trial, TrialMetrics]], path: Path) -> None:
    """Run failed trials again and draw three pictures of each.

    They show the trial a second before it failed, when it failed, and a second later or at its end.
    """
    pictures: list[tuple[str, Image]] = []
    for inputs, trial, result in failed:
        pictures += _failure(inputs, trial, result)
    sheet(pictures, 3, path)


def _failure(inputs: MethodInputs, trial: Trial, result: TrialMetrics) -> list[tuple[str, Image]]:
    bench = Bench(result.method, inputs, result.condition, visuals=True)
    named_objects = (name for name in bench.task.objects if name in result.reason)
    shown_object = bench.world.truth(next(named_objects, bench.task.carried))
    images: list[Image] = []
    with Camera(bench.world.model, *FAILURE_SIZE, shadows=True) as camera:

        def photograph(world: World, _method: object) -> None:
            if len(images) == len(_AROUND_S):
                return
            due_s = result.failed_at_s + _AROUND_S[len(images)]
            if world.time >= due_s:
                position = shown_object.pose()[:3, 3]
                images.append(camera.close_up(world.data, position).copy())

        bench.run(trial, on_step=photograph)
    before = images[0]
    at_failure = images[min(1, len(images) - 1)]
    after = images[-1]
    return [
        (f"{result.method}, {result.condition}, trial {result.index}", before),
        (f"not '{result.failure}' at {result.failed_at_s:.2f} s", at_failure),
        (textwrap.fill(result.reason, 46), after),
    ]


def film_demonstration(job: Job, index: int, path: Path) -> None:
    """Lead trial `index` of a recording again and film it."""
    rig = Rig(job, ())
    postures = Postures(1.0 / FILM_FPS)
    trial = job.trial(index)
    rig.lead(trial, lambda _tick: postures(rig.world))
    rig.close()
    with rig.room(trial):
        film_postures(rig.world.model, postures.qpos, path)


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

    def __call__(self, world: World) -> None:
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
    camera: str = "overview",
    shadows: bool = True,
) -> int:
    """Write an mp4 of a model with visuals; return the number of frames."""
    return write_video(path, _pictures(model, qpos, camera, shadows=shadows), fps=FILM_FPS)


def sheet_of_postures(
    model: mujoco.MjModel,
    postures: Postures,
    path: Path,
    *,
    frames: int,
    camera: str = "overview",
) -> int:
    """Draw up to `frames` evenly spaced postures of a model with visuals; return their number."""
    evenly = np.linspace(0, len(postures.times) - 1, frames)
    chosen = np.unique(evenly.round().astype(int))
    pictures = _pictures(model, [postures.qpos[i] for i in chosen], camera, shadows=True)
    named = [
        (f"{postures.times[i]:.3f} s", picture.copy())
        for i, picture in zip(chosen, pictures, strict=True)
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
    data = mujoco.MjData(model)
    with Camera(model, *FILM_SIZE, shadows=shadows) as renderer:
        for posture in qpos:
            data.qpos[:] = posture
            mujoco.mj_forward(model, data)
            yield renderer.picture(data, camera)
