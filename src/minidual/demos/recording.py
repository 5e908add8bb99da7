"""Record trials in several processes, or continue an interrupted recording.

Results depend neither on workers nor on interruptions.
"""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from minidual import durable
from minidual.demos.checks import camera_references, check_swapped
from minidual.demos.leader import LEADERS
from minidual.demos.quality import EpisodeQuality
from minidual.demos.rig import ATTEMPTS, KEPT, REJECTED, Attempt, Job, Rig
from minidual.errors import DataError
from minidual.workers import in_workers

INPUTS_FILE = "inputs.json"
PARTS = (KEPT, REJECTED, ATTEMPTS, INPUTS_FILE)
"""Entries of a recording's folder that an interruption leaves there."""
Observe = Callable[[Rig, int], AbstractContextManager[object]]
"""Returns a context entered during the trial."""

_rigs: dict[str, Rig] = {}


def claim(folder: Path, inputs: Mapping[str, Any], name: str) -> str:
    """Prepare `folder` for a recording made from `inputs` (JSON types); return a message about an earlier one, or "".

    An interrupted recording with equal inputs stays, to be continued. Another one moves to `set-aside` beside `folder`,
    under `name`.
    """
    path = folder / INPUTS_FILE
    gathered = folder.with_name(f".{name}.aside")
    if gathered.exists():  # killed while it was set aside
        durable.set_aside(gathered, name)
    before: Any = {}
    with suppress(DataError):  # missing or damaged: the recording is set aside
        before = durable.read_json(path)
    before = before if isinstance(before, dict) else {}
    note = ""
    begun = any((folder / part).exists() for part in (KEPT, REJECTED, ATTEMPTS))
    if begun and before != inputs:
        gathered.mkdir()
        for part in (folder / part for part in PARTS):
            if part.exists():
                part.rename(gathered / part.name)
        target = durable.set_aside(gathered, name)
        changed = sorted(
            key for key in before.keys() | inputs.keys() if before.get(key) != inputs.get(key)
        )
        note = f"an interrupted recording with other inputs ({', '.join(changed)}) was moved to {target}"
    elif begun:
        halves = durable.remove_stale(folder.glob("*/.*.partial"))
        done = len(list((folder / KEPT).glob("*.hdf5")))
        note = f"an interrupted recording is continued: demonstrations so far: {done}"
        note += "".join(f"; removed {half.name}, which is half-written" for half in halves)
    durable.write_text(path, json.dumps(inputs, indent=1, sort_keys=True) + "\n")
    return note


def _record_in_worker(job: Job, index: int, observe: Observe | None) -> Attempt:
    key = f"{job.folder}/{job.seed}/{job.teleop}/{job.task.config}/{job.arbiter}"
    if key not in _rigs:
        while _rigs:
            _rigs.popitem()[1].close()
        _rigs[key] = Rig(job, job.teleop.cameras)
    rig = _rigs[key]
    with nullcontext() if observe is None else observe(rig, index):
        return rig.record(index)


def usable_workers(job: Job, workers: int) -> int:
    """Return the number of processes, 1 for real-time leaders."""
    return 1 if LEADERS[job.teleop.leader].realtime else workers


class RecordedAttempts(NamedTuple):
    """All attempts in order."""

    attempts: tuple[Attempt, ...]
    workers: int

    @property
    def kept(self) -> tuple[Attempt, ...]:
        """Demonstrations in order."""
        return tuple(a for a in self.attempts if a.kept)

    def numbers(self, elapsed_s: float = 0.0) -> dict[str, float]:
        """Return the judged numbers; NaN propagates and fails its check.

        Rates leave process start out. `elapsed_s`: from the first attempt to the finished dataset, of this process.
        """
        qualities = [cast(EpisodeQuality, a.quality) for a in self.kept]
        latencies = np.concatenate([a.latencies_s for a in self.attempts])
        recording_s, before_s = (
            sum(a.wall_s for a in self.attempts if a.adopted >= k) / self.workers for k in (0, 1)
        )
        synchronised = [
            a.sync_error_max_s for a in self.attempts if a.kept or np.isfinite(a.sync_error_max_s)
        ]
        return {
            "episodes": len(self.kept),
            "attempts": len(self.attempts),
            "success_rate": float(np.mean([a.success for a in self.attempts])),
            "schema_ok": bool(self.kept) and not any(a.faults for a in self.kept),
            "jerk_rms_max": max(quality.rms_jerk_rad_s3 for quality in qualities),
            "sync_error_max_s": float(np.max(synchronised)),
            "latency_p50_s": float(np.percentile(latencies, 50)),
            "latency_p99_s": float(np.percentile(latencies, 99)),
            "episodes_per_min": 60.0 * len(self.kept) / max(recording_s, before_s + elapsed_s),
            "recorded_per_min": 60.0 * len(self.kept) / recording_s,
            "recorded_ticks": sum(quality.ticks for quality in qualities),
        }


def attempts_of(job: Job, workers: int, observe: Observe | None = None) -> Iterator[Attempt]:
    """Yield attempts in order, until there are `episodes_n` demonstrations or the attempts allowed are used up.

    Attempts that an interrupted recording left in `job.folder` count (see `claim`). `observe` needs one worker.

    Raises:
        UsageError, HandoverError: The leader is unknown, displaced or refused.
        EnvironmentMissingError: Missing device or renderer.
    """
    allowed = math.ceil(job.teleop.episodes_n * job.teleop.attempts_max_ratio)
    tried = 0
    missing = job.teleop.episodes_n
    while missing > 0 and tried < allowed:
        indices = range(tried, min(tried + missing, allowed))
        for attempt in in_workers(
            lambda i: _record_in_worker(job, i, observe),
            indices,
            usable_workers(job, workers),
        ):
            tried = tried + 1
            missing = missing - attempt.kept
            yield attempt


def recording_of(job: Job, workers: int, attempts: Sequence[Attempt]) -> RecordedAttempts:
    """Return the recording, with the faults that only all attempts show."""
    references = camera_references([a.views for a in attempts if a.kept])
    judged = (
        replace(a, faults=(*a.faults, *map(str, check_swapped(a.views, references))))
        for a in attempts
    )
    return RecordedAttempts(tuple(judged), min(usable_workers(job, workers), job.teleop.episodes_n))


def record(job: Job, *, workers: int) -> RecordedAttempts:
    """See `attempts_of`."""
    return recording_of(job, workers, list(attempts_of(job, workers)))
