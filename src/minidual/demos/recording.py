"""Record trials, one or many, over processes: what the `teleop-record` stage runs.

The number of workers changes nothing but the time: each trial is drawn from its own number, runs in its own
episode of simulated time, and attempts are made in rounds of known size, in order.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from minidual import durable
from minidual.demos.leader import IN_PROCESS, require_leader
from minidual.demos.rig import REJECTED, Attempt, Job, Rig
from minidual.tasks.rod_carry import placement

Observe = Callable[[Rig, int], AbstractContextManager[object]]
"""Called with the rig and a trial's number; what it returns is entered while the trial runs."""

_rigs: dict[str, Rig] = {}


def _record_in_worker(job: Job, index: int, observe: Observe | None = None) -> Attempt:
    key = f"{job.folder}/{job.seed}/{job.teleop}/{job.task.scene}/{job.arbiter}"
    if key not in _rigs:
        for rig in _rigs.values():
            rig.close()
        _rigs.clear()
        _rigs[key] = Rig(job, job.teleop.cameras)
    rig = _rigs[key]
    began = time.perf_counter()
    with nullcontext() if observe is None else observe(rig, index):
        attempt = rig.record(index)
    return replace(attempt, wall_s=time.perf_counter() - began)


def usable_workers(job: Job, workers: int) -> int:
    """Return over how many processes a recording can be spread: one, if the leader needs this one's terminal."""
    return 1 if job.teleop.leader in IN_PROCESS else workers


def record_attempts(
    job: Job, indices: Sequence[int], *, workers: int, observe: Observe | None = None
) -> Iterator[Attempt]:
    """Record trials over processes and yield what became of them, in the order of `indices`.

    An observer runs in this process, which needs `workers` to be 1.
    """
    import joblib

    # One numeric thread a process: on a busy machine more of them only wait for each other.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    os.environ.setdefault("LP_NUM_THREADS", "0")  # the software renderer draws in the calling thread
    processes = min(usable_workers(job, workers), max(1, len(indices)))
    yield from joblib.Parallel(n_jobs=processes, return_as="generator", batch_size=1, pre_dispatch="2*n_jobs")(
        joblib.delayed(_record_in_worker)(job, index, observe) for index in indices
    )


@dataclass(frozen=True)
class Recording:
    """All attempts of a recording, in order, and how long they took.

    Attributes:
        attempts: One a trial.
        wall_s: Wall-clock time from the first to the last, start of the processes included.
        workers: Processes they were spread over.
    """

    attempts: tuple[Attempt, ...]
    wall_s: float
    workers: int

    @property
    def episodes_per_min(self) -> float:
        """Demonstrations a minute once the processes run; their start, paid once, would hide it in a short run."""
        return 60.0 * len(self.kept) * self.workers / sum(a.wall_s for a in self.attempts)

    @property
    def kept(self) -> tuple[Attempt, ...]:
        """The demonstrations, in the order of their trials."""
        return tuple(a for a in self.attempts if a.kept)

    @property
    def paths(self) -> list[Path]:
        """Files of the demonstrations."""
        return [a.path for a in self.kept if a.path is not None]


def record(
    job: Job, *, workers: int, on_attempt: Callable[[Attempt], None] | None = None, observe: Observe | None = None
) -> Recording:
    """Record until there are `episodes_n` demonstrations, or the allowed attempts are used up.

    A round tries as many trials as demonstrations are still missing, so which trials are tried depends on
    their results alone and not on which worker was fastest.

    Raises:
        UsageError: There is no such leader, or it does not stand where the follower does.
        EnvironmentMissingError: What the leader or the cameras need is not there.
        DataError: The disk refuses a file.
    """
    require_leader(job.teleop.leader)
    wanted = job.teleop.episodes_n
    allowed = int(np.ceil(wanted * job.teleop.attempts_max_ratio))
    attempts: list[Attempt] = []
    began = time.perf_counter()
    while (missing := wanted - sum(a.kept for a in attempts)) > 0 and len(attempts) < allowed:
        start = len(attempts)
        for attempt in record_attempts(
            job, range(start, min(start + missing, allowed)), workers=workers, observe=observe
        ):
            attempts.append(attempt)
            if on_attempt is not None:
                on_attempt(attempt)
    if all(a.path is None or a.kept for a in attempts):
        durable.remove(job.folder / REJECTED)
    return Recording(tuple(attempts), time.perf_counter() - began, min(usable_workers(job, workers), wanted))


def quality_row(attempt: Attempt) -> dict[str, Any]:
    """Return an attempt as one flat row for CSV."""
    x, y, yaw = placement(next(iter(attempt.trial.start.values())))
    row: dict[str, Any] = {
        "trial": attempt.trial.index,
        "start_x_m": x,
        "start_y_m": y,
        "start_yaw_rad": yaw,
        "success": attempt.success,
        "kept": attempt.kept,
        "reason": attempt.reason,
        "completion_s": attempt.completion_s,
        "goal_error_m": attempt.goal_error_m,
        "tilt_max_rad": attempt.tilt_max_rad,
        "file": "",
        "ticks": 0,
        "duration_s": "",
        "rms_jerk_rad_s3": "",
        "path_length_m": "",
        "path_efficiency": "",
        "cells_n": "",
    }
    if attempt.quality is not None:
        row.update({k: v for k, v in attempt.quality.to_dict().items() if k in row and k != "success"})
    return {k: round(v, 6) if isinstance(v, float) else v for k, v in row.items()}
