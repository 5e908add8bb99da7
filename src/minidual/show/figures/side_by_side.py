"""A film of several methods on the same start, side by side and in step."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from minidual.plant.render import Image, write_video
from minidual.plant.simulation import Simulation
from minidual.robot.pair import Array
from minidual.show.figures.film_camera import FilmCamera
from minidual.show.figures.film_caption import Caption, captioned
from minidual.show.figures.film_model import painted
from minidual.show.forces import force_arrows
from minidual.show.view.overlay import Arrow
from minidual.tasks.failures import failure_words
from minidual.tasks.task import Trial
from minidual.trials.conditions import CLEAN
from minidual.trials.methods import Method, MethodInputs
from minidual.trials.metrics import TrialMetrics
from minidual.trials.runner import Bench
from minidual.trials.site import Site

FPS = 12
_PANE_SIZES = {1: (848, 480), 2: (640, 360)}
"""Width and height of a pane by the number of panes."""
_SMALL_PANE = (480, 270)
_LAST_S = 2.0
"""How long the last frames stay."""


class Moment(NamedTuple):
    """One instant of a film.

    Attributes:
        qpos: (nq,).
        phase: Of the method.
        pinch_n: Of left and right hand.
        squeeze_n: Along the object.
        arrows: Forces of the hands.
    """

    time_s: float
    qpos: Array
    phase: str
    pinch_n: tuple[float, float] = (0.0, 0.0)
    squeeze_n: float = 0.0
    arrows: tuple[Arrow, ...] = ()


@dataclass(frozen=True)
class Take:
    """One method's trial, with the frames to show.

    Attributes:
        title: Name of the method.
        model: Of a film.
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

    def caption(self, time_s: float) -> Caption:
        """Return the text of the bar at a time: the phase, and at the end the result."""
        moment = self.at(time_s)
        clock = f"{min(time_s, self.end_s):.2f} s"
        if time_s < self.end_s:
            return Caption(self.title, clock, moment.phase, _forces(moment))
        result = self.result
        if result.success:
            text = f"success in {result.duration_s:.2f} s"
            return Caption(self.title, clock, text, _figures(result), success=True)
        place = f" in phase '{result.failed_in}'" if result.failed_in else ""
        text = f"failed at {result.failed_at_s:.2f} s{place}"
        reason = result.reason or failure_words(result.failure)
        return Caption(self.title, clock, text, reason, success=False)


def _forces(moment: Moment) -> str:
    left_n, right_n = (round(force_n) for force_n in moment.pinch_n)
    squeeze_n = round(moment.squeeze_n)  # an integer has no negative zero
    return f"pinch {left_n} N, {right_n} N   squeeze {squeeze_n} N"


def _figures(result: TrialMetrics) -> str:
    tilt_deg = np.rad2deg(result.tilt_max_rad)
    return f"tilt {tilt_deg:.1f} deg   torque {100.0 * result.torque_ratio_max:.0f} % of the limit"


@dataclass
class _Sampler:
    """Step hook that samples moments at FPS."""

    moments: list[Moment] = field(default_factory=list)
    began_s: float | None = None

    def __call__(self, world: Simulation, method: Method) -> None:
        if self.began_s is None:
            self.began_s = world.time
        time_s = world.time - self.began_s
        if time_s < len(self.moments) / FPS - 1e-9:
            return
        truths = [world.truth(name) for name in world.objects]
        left_n, right_n = np.max([truth.pinch() for truth in truths], axis=0).tolist()
        moment = Moment(
            time_s=time_s,
            qpos=world.data.qpos.copy(),
            phase=method.phase,
            pinch_n=(left_n, right_n),
            squeeze_n=max(truth.internal_force() for truth in truths),
            arrows=force_arrows(world),
        )
        self.moments.append(moment)


def take(
    method: str,
    inputs: MethodInputs,
    trial: Trial,
    *,
    condition: str = CLEAN,
    fine: bool = False,
    site: Site | None = None,
) -> Take:
    """Run a trial and keep the instants of its film; `fine` shows the arms in full detail."""
    bench = Bench(method, inputs, condition, site=site)
    sampler = _Sampler()
    models: list[mujoco.MjModel] = []

    def watch(world: Simulation, running: Method) -> None:
        if not models:  # the condition has changed the world's model by now
            models.append(painted(world.scene, world.robot, world.model, fine=fine))
        sampler(world, running)

    result, _ = bench.run(trial, on_step=watch)
    return Take(method, models[0], sampler.moments, result)


def pane_size(panes_n: int) -> tuple[int, int]:
    """Return width and height [px] of each of so many pictures."""
    return _PANE_SIZES.get(panes_n, _SMALL_PANE)


def film_takes(
    takes: Sequence[Take],
    path: Path,
    *,
    speed: float = 1.0,
    fps: int = FPS,
    size_px: tuple[int, int] | None = None,
) -> int:
    """Write an mp4 of takes side by side; return the number of frames.

    Args:
        takes: At least one.
        path: Of the film.
        speed: Simulated time over the time of the film.
        fps: Frames a second of the film.
        size_px: Width and height of a pane; None chooses by their number.
    """
    frames = frames_of(takes, speed=speed, fps=fps, size_px=size_px)
    return write_video(path, frames, fps=fps)


def frames_of(
    takes: Sequence[Take],
    *,
    speed: float = 1.0,
    fps: int = FPS,
    size_px: tuple[int, int] | None = None,
) -> Iterator[Image]:
    """Yield the frames (H, W, 3) of a film; `size_px` is that of one pane."""
    longest_s = max(each.end_s for each in takes)
    frames_n = round((longest_s / speed + _LAST_S) * fps)
    size_px = size_px or pane_size(len(takes))
    last_panes: list[Image | None] = [None] * len(takes)
    with ExitStack() as open_cameras:
        cameras = [open_cameras.enter_context(FilmCamera(each.model, size_px)) for each in takes]
        for frame in range(frames_n):
            time_s = speed * frame / fps
            for number, (each, camera) in enumerate(zip(takes, cameras, strict=True)):
                is_over = time_s > each.end_s + speed / fps
                if is_over and last_panes[number] is not None:
                    continue  # nothing moves any more
                moment = each.at(time_s)
                picture = camera.picture(moment.qpos, moment.arrows)
                last_panes[number] = captioned(picture, each.caption(time_s))
            panes = [pane for pane in last_panes if pane is not None]
            yield np.concatenate(panes, axis=1)
