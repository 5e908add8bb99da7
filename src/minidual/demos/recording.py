"""Record trials over processes.

Results do not depend on the workers: each trial has its own random draw and simulated time, and rounds have known size.
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
from minidual.demos.checks import camera_references, check_swapped
from minidual.demos.leader import LEADERS
from minidual.demos.rig import REJECTED, Attempt, Job, Rig
from minidual.demos.smoothness import JERK_FILTER
from minidual.workers import in_workers

Observe = Callable[[Rig, int], AbstractContextManager[object]]
"""Returns a context entered during the trial."""

_rigs: dict[str, Rig] = {}


def _record_in_worker(job: Job, index: int, observe: Observe | None = None) -> Attempt:
    key = f"{job.folder}/{job.seed}/{job.teleop}/{job.task.config}/{job.arbiter}"
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
    """Return the number of processes, 1 for real-time leaders."""
    return 1 if LEADERS[job.teleop.leader].realtime else workers


def record_attempts(
    job: Job, indices: Sequence[int], *, workers: int, observe: Observe | None = None
) -> Iterator[Attempt]:
    """Yield attempts in order; `observe` requires `workers` 1."""
    os.environ.setdefault("LP_NUM_THREADS", "0")  # the software renderer uses the calling thread
    yield from in_workers(lambda index: _record_in_worker(job, index, observe), indices, workers)


@dataclass(frozen=True)
class RecordingNumbers:
    """Judged numbers; extremes over kept demonstrations."""

    episodes: int
    attempts: int
    successes: int
    files_at_fault: int
    jerk_rms_max: float
    sync_error_max_s: float
    latency_p50_s: float
    latency_p99_s: float
    episodes_per_min: float
    recorded_ticks: int
    dataset_rows: int
    dataset_episodes: int


@dataclass(frozen=True)
class Recording:
    """All attempts in order; `wall_s` includes process start."""

    attempts: tuple[Attempt, ...]
    wall_s: float
    workers: int

    @property
    def episodes_per_min(self) -> float:
        """Demonstrations per minute, without process start."""
        return 60.0 * len(self.kept) * self.workers / sum(a.wall_s for a in self.attempts)

    @property
    def kept(self) -> tuple[Attempt, ...]:
        """Demonstrations in order."""
        return tuple(a for a in self.attempts if a.kept)

    @property
    def paths(self) -> list[Path]:
        """Demonstration files."""
        return [a.path for a in self.kept if a.path is not None]

    def numbers(self, dataset_rows: int, dataset_episodes: int) -> RecordingNumbers:
        """Return the judged numbers; NaN propagates and fails its check."""
        latencies = np.concatenate([a.latencies_s for a in self.attempts if a.latencies_s is not None])
        qualities = [a.quality for a in self.kept if a.quality is not None]
        return RecordingNumbers(
            episodes=len(self.kept),
            attempts=len(self.attempts),
            successes=sum(a.success for a in self.attempts),
            files_at_fault=sum(bool(a.problems) for a in self.kept),
            jerk_rms_max=float(np.max([q.rms_jerk_rad_s3 for q in qualities])),
            sync_error_max_s=float(np.max([a.sync_error_max_s for a in self.kept])),
            latency_p50_s=float(np.percentile(latencies, 50)),
            latency_p99_s=float(np.percentile(latencies, 99)),
            episodes_per_min=self.episodes_per_min,
            recorded_ticks=sum(q.ticks for q in qualities),
            dataset_rows=dataset_rows,
            dataset_episodes=dataset_episodes,
        )

    def facts(self) -> dict[str, Any]:
        """Return the numbers for the report."""
        qualities = [a.quality for a in self.kept if a.quality is not None]
        outcomes = [a.outcome for a in self.kept if a.outcome is not None]
        return {
            "attempts": len(self.attempts),
            "kept": len(self.kept),
            "rejected": {str(a.trial.index): a.reason for a in self.attempts if not a.kept},
            "faults": {str(a.trial.index): list(a.problems) for a in self.attempts if a.problems},
            "trials": [a.trial.index for a in self.kept],
            "jerk_filter": JERK_FILTER,
            "jerk_rms_median": float(np.median([q.rms_jerk_rad_s3 for q in qualities])),
            "path_efficiency_median": float(np.median([q.path_efficiency for q in qualities])),
            "duration_median_s": float(np.median([q.duration_s for q in qualities])),
            "goal_error_max_m": float(np.max([o.goal_error_m for o in outcomes])),
            "tilt_max_rad": float(np.max([o.tilt_max_rad for o in outcomes])),
            "recording_s": self.wall_s,
        }


def record(
    job: Job, *, workers: int, on_attempt: Callable[[Attempt], None] | None = None, observe: Observe | None = None
) -> Recording:
    """Record rounds until there are `episodes_n` demonstrations or attempts run out.

    Raises:
        UsageError: Unknown or displaced leader.
        HandoverError: The arbiter refused the leader.
        EnvironmentMissingError: Missing device or renderer.
        DataError: Disk error.
    """
    wanted, used = job.teleop.episodes_n, usable_workers(job, workers)
    allowed = int(np.ceil(wanted * job.teleop.attempts_max_ratio))
    attempts: list[Attempt] = []
    began = time.perf_counter()
    while (missing := wanted - sum(a.kept for a in attempts)) > 0 and len(attempts) < allowed:
        indices = range(len(attempts), min(len(attempts) + missing, allowed))
        for attempt in record_attempts(job, indices, workers=used, observe=observe):
            attempts.append(attempt)
            if on_attempt is not None:
                on_attempt(attempt)
    if all(a.path is None or a.kept for a in attempts):
        durable.remove(job.folder / REJECTED)
    references = camera_references([a.views for a in attempts if a.kept])
    for k, a in enumerate(attempts):
        swapped = tuple(map(str, check_swapped(a.views, references)))
        attempts[k] = replace(a, problems=a.problems + swapped)
    return Recording(tuple(attempts), time.perf_counter() - began, min(used, wanted))
