"""Films of `benchmark`: of each task the same start by every method, side by side and in step."""

import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from minidual.gate.stage import StageContext
from minidual.show.figures.side_by_side import film_takes, take
from minidual.trials.benchmark import draw_under
from minidual.trials.conditions import CLEAN
from minidual.trials.methods import MethodInputs
from minidual.trials.metrics import TrialMetrics
from minidual.workers import in_workers

FPS = 8
PANE_PX = (400, 226)
_LONGEST_S = 12.0
"""Longer trials are shown faster than they were."""


class FilmJob(NamedTuple):
    """A film to make.

    Attributes:
        methods: Side by side, in this order.
        index: Of the start.
    """

    inputs: MethodInputs
    methods: tuple[str, ...]
    index: int

    @property
    def name(self) -> str:
        """Of the file."""
        return f"film-{self.inputs.config.task}.mp4"


def film_jobs(
    inputs: Mapping[str, MethodInputs],
    methods: Sequence[str],
    trials: Mapping[str, Sequence[TrialMetrics]],
) -> list[FilmJob]:
    """Return a film for each task.

    It shows the first undisturbed start at which one method succeeds and another one fails; without
    such a start the first.

    Args:
        inputs: By task.
        methods: Of the benchmark; those without trials cannot do the task.
        trials: Results by task.
    """
    jobs: list[FilmJob] = []
    for task, task_inputs in inputs.items():
        clean = [trial for trial in trials[task] if trial.condition == CLEAN]
        tried = {trial.method for trial in clean}
        able = [method for method in methods if method in tried]
        if able:
            jobs.append(FilmJob(task_inputs, tuple(able), _telling_start(clean)))
    return jobs


def _telling_start(trials: Sequence[TrialMetrics]) -> int:
    successes: dict[int, set[bool]] = {}
    for trial in trials:
        successes.setdefault(trial.index, set()).add(trial.success)
    indices = sorted(successes)
    return next((index for index in indices if len(successes[index]) > 1), indices[0])


def write_films(context: StageContext, jobs: Sequence[FilmJob]) -> dict[str, str]:
    """Write the films; return {file: caption}."""
    captions: dict[str, str] = {}
    make = functools.partial(_write, context.folder)
    with context.progress.task("films", len(jobs)) as progress:
        for job, speed in zip(jobs, in_workers(make, jobs, context.workers), strict=True):
            captions[job.name] = caption(job, speed)
            progress.advance(note=job.inputs.config.task)
    return captions


def _write(folder: Path, job: FilmJob) -> int:
    """Run the trials of a film and write it; return how much faster than life it is."""
    trial = draw_under(job.inputs, CLEAN)(job.index)
    takes = [take(method, job.inputs, trial) for method in job.methods]
    longest_s = max(each.end_s for each in takes)
    speed = max(1, math.ceil(longest_s / _LONGEST_S))
    film_takes(takes, folder / job.name, speed=speed, fps=FPS, size_px=PANE_PX)
    return speed


def caption(job: FilmJob, speed: int) -> str:
    """Return the caption of a film."""
    names = " and ".join([", ".join(job.methods[:-1]), job.methods[-1]]).removeprefix(" and ")
    faster = f", {speed} times as fast" if speed > 1 else ""
    return f"{job.inputs.config.task}: start {job.index}, undisturbed, by {names}{faster}"
