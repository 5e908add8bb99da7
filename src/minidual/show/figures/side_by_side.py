"""A film of several methods on the same start, side by side and in step."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from PIL import Image as Picture
from PIL import ImageDraw, ImageFont

from minidual.plant.render import Camera, Image, write_video
from minidual.plant.world import World
from minidual.robot.pair import Array
from minidual.show.figures.film_model import CAMERA, film_model, paint_as
from minidual.tasks.task import Trial
from minidual.trials.conditions import CLEAN
from minidual.trials.methods import Method, MethodInputs
from minidual.trials.metrics import TrialMetrics
from minidual.trials.runner import Bench

FPS = 12
"""Drawn in software, each frame of three methods takes 0.2 s."""
PANE_SIZE = (480, 360)
_BAR_PX = 66
_LAST_S = 2.0
"""How long the last frames stay."""
_RUNNING = (38, 50, 66)
_SUCCESS = (22, 110, 60)
_FAILURE = (168, 40, 34)


class Moment(NamedTuple):
    """What a film shows of one instant.

    Attributes:
        qpos: (nq,).
        phase: Of the method.
        force_n: Largest pinch of a hand.
    """

    time_s: float
    qpos: Array
    phase: str
    force_n: float


@dataclass(frozen=True)
class Take:
    """One method's trial, as it is to be shown.

    Attributes:
        title: Name of the method.
        model: With visuals.
        moments: At FPS of simulated time, the first at its begin.
        result: Of the trial.
    """

    title: str
    model: mujoco.MjModel
    moments: Sequence[Moment]
    result: TrialMetrics

    def at(self, time_s: float) -> Moment:
        """Return the moment at a time, or the last one."""
        index = min(round(time_s * FPS), len(self.moments) - 1)
        return self.moments[index]

    @property
    def end_s(self) -> float:
        """Time of the last moment."""
        return (len(self.moments) - 1) / FPS


class _Sampler:
    """Step hook that samples moments."""

    def __init__(self) -> None:
        self.moments: list[Moment] = []

    def __call__(self, world: World, method: Method) -> None:
        if world.time < len(self.moments) / FPS - 1e-9:
            return
        pinches_n = [float(world.truth(name).pinch().max()) for name in world.objects]
        moment = Moment(world.time, world.data.qpos.copy(), method.phase, max(pinches_n))
        self.moments.append(moment)


def take(
    method: str,
    inputs: MethodInputs,
    trial: Trial,
    *,
    condition: str = CLEAN,
) -> Take:
    """Run a trial and keep what a film shows of it."""
    bench = Bench(method, inputs, condition, visuals=True)
    world = bench.world
    model = copy(film_model(world.scene, world.robot))  # type: ignore[arg-type]  # frozen: hashable
    sampler = _Sampler()

    def watch(shown: World, running: Method) -> None:
        if not sampler.moments:  # the condition has changed its model by now
            paint_as(model, shown.model)
        sampler(shown, running)

    result, _ = bench.run(trial, on_step=watch)
    return Take(method, model, sampler.moments, result)


def film_takes(takes: Sequence[Take], path: Path) -> int:
    """Write an mp4 of takes side by side; return the number of frames."""
    return write_video(path, _frames(takes), fps=FPS)


def _frames(takes: Sequence[Take]) -> Iterator[Image]:
    longest_s = max(each.end_s for each in takes)
    frames_n = round((longest_s + _LAST_S) * FPS)
    with ExitStack() as open_cameras:
        cameras = [
            open_cameras.enter_context(Camera(each.model, *PANE_SIZE, shadows=True))
            for each in takes
        ]
        scenes = [mujoco.MjData(each.model) for each in takes]
        for frame in range(frames_n):
            time_s = frame / FPS
            panes: list[Image] = []
            for each, camera, data in zip(takes, cameras, scenes, strict=True):
                data.qpos[:] = each.at(time_s).qpos
                mujoco.mj_forward(each.model, data)
                picture = camera.picture(data, CAMERA)
                panes.append(captioned(picture, each, time_s))
            yield np.concatenate(panes, axis=1)


def captioned(picture: Image, shown: Take, time_s: float) -> Image:
    """Return the picture (H, W, 3) above a bar with method, phase, force, time and result."""
    height, width = picture.shape[:2]
    moment = shown.at(time_s)
    ended = time_s >= shown.end_s
    colour = _RUNNING
    text = f"{moment.phase}   {moment.force_n:.0f} N"
    if ended and shown.result.success:
        colour = _SUCCESS
        text = f"success in {shown.result.duration_s:.2f} s"
    elif ended:
        colour = _FAILURE
        text = f"failed: {shown.result.failure}"
    frame = Picture.new("RGB", (width, height + _BAR_PX), colour)
    frame.paste(Picture.fromarray(picture), (0, 0))
    draw = ImageDraw.Draw(frame)
    large = ImageFont.load_default(size=22)
    small = ImageFont.load_default(size=16)
    margin = 12
    draw.text((margin, height + 6), shown.title, fill="white", font=large)
    clock = f"{min(time_s, shown.end_s):5.2f} s"
    draw.text((width - margin, height + 6), clock, fill="white", font=large, anchor="ra")
    draw.text((margin, height + 38), text, fill="white", font=small)
    return np.asarray(frame)
