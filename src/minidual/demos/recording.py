"""Record trials in several processes, or continue an interrupted recording.

Results depend neither on workers nor on interruptions.
"""

import json
import math
import sys
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from minidual import durable
from minidual.demos.attempt import ATTEMPTS, KEPT, REJECTED, Attempt
from minidual.demos.checks import camera_references, check_swapped
from minidual.demos.job import Job
from minidual.demos.leader import LEADERS
from minidual.demos.quality import EpisodeQuality
from minidual.demos.rig import Rig
from minidual.errors import DataError
from minidual.robot.pair import Array
from minidual.workers import in_workers

INPUTS_FILE = "inputs.json"
PARTS = (KEPT, REJECTED, ATTEMPTS, INPUTS_FILE)
"""Entries of a recording's folder that an interruption leaves there."""
Observe = Callable[[Rig, int], AbstractContextManager[object]]
"""Returns a context entered during the trial."""

_rigs: dict[str, Rig] = {}
"""The rig of this process, by its job."""


def claim(folder: Path, inputs: Mapping[str, Any], name: str) -> str:
    """Prepare `folder` for a recording made from `inputs` (JSON types).

    An interrupted recording with equal inputs stays, to be continued. Another one moves to
    `set-aside` beside `folder`, under `name`.

    Returns:
        A message about an earlier recording, or "".
    """
    gathered = folder.with_name(f".{name}.aside")
    if gathered.exists():  # killed while it was set aside
        durable.set_aside(gathered, name)
    earlier_inputs = _read_inputs(folder)
    begun = any((folder / part).exists() for part in (KEPT, REJECTED, ATTEMPTS))
    if not begun:
        note = ""
    elif earlier_inputs == inputs:
        note = _continue(folder)
    else:
        target = _set_aside(folder, gathered, name)
        changed = ", ".join(_changed_keys(earlier_inputs, inputs))
        note = f"an interrupted recording with other inputs ({changed}) was moved to {target}"
    durable.write_text(folder / INPUTS_FILE, json.dumps(inputs, indent=1, sort_keys=True) + "\n")
    return note


def _read_inputs(folder: Path) -> dict[str, Any]:
    """Return the inputs of the recording in `folder`, none if they are missing or damaged."""
    try:
        inputs = durable.read_json(folder / INPUTS_FILE)
    except DataError:
        return {}
    return inputs if isinstance(inputs, dict) else {}


def _continue(folder: Path) -> str:
    """Remove half-written files; return a message."""
    removed = durable.remove_stale(folder.glob("*/.*.partial"))
    demonstrations_n = len(list((folder / KEPT).glob("*.hdf5")))
    note = f"an interrupted recording is continued: demonstrations so far: {demonstrations_n}"
    for path in removed:
        note += f"; removed {path.name}, which is half-written"
    return note


def _set_aside(folder: Path, gathered: Path, name: str) -> Path:
    """Move the recording aside by way of the folder `gathered`; return its new path."""
    gathered.mkdir()
    for part in PARTS:
        path = folder / part
        if path.exists():
            path.rename(gathered / part)
    return durable.set_aside(gathered, name)


def _changed_keys(first: Mapping[str, Any], second: Mapping[str, Any]) -> list[str]:
    return sorted(key for key in first.keys() | second.keys() if first.get(key) != second.get(key))


def _record_in_worker(job: Job, index: int, observe: Observe | None) -> Attempt:
    key = f"{job.folder}/{job.seed}/{job.teleop}/{job.task.config}/{job.arbiter}"
    if key not in _rigs:
        _close_rigs()
        _rigs[key] = Rig(job, job.teleop.cameras)
    rig = _rigs[key]
    observed = nullcontext() if observe is None else observe(rig, index)
    with observed:
        return rig.record(index)


def _close_rigs() -> None:
    while _rigs:
        _, rig = _rigs.popitem()
        rig.close()


def led_by_person(job: Job) -> bool:
    """Return whether a person or device leads, in real time."""
    return LEADERS[job.teleop.leader].features.realtime


def usable_workers(job: Job, workers: int) -> int:
    """Return the number of processes, 1 for real-time leaders."""
    return 1 if led_by_person(job) else workers


class RecordedAttempts(NamedTuple):
    """All attempts in order."""

    attempts: tuple[Attempt, ...]
    workers: int

    @property
    def kept(self) -> tuple[Attempt, ...]:
        """Demonstrations in order."""
        return tuple(attempt for attempt in self.attempts if attempt.kept)

    @property
    def lags_s(self) -> Array:
        """Lags of the moving samples of all demonstrations (m,), see `demos.lag`."""
        lags = [attempt.lag.samples_s for attempt in self.kept if attempt.lag is not None]
        return np.concatenate([np.empty(0), *lags])

    def numbers(self, elapsed_s: float = 0.0) -> dict[str, float]:
        """Return the judged numbers; NaN propagates and fails its check.

        Rates leave process start out. `elapsed_s`: from the first attempt to the finished dataset,
        of this process.
        """
        qualities = [cast(EpisodeQuality, attempt.quality) for attempt in self.kept]
        latencies_s = np.concatenate([attempt.latencies_s for attempt in self.attempts])
        lags_s = self.lags_s if len(self.lags_s) else np.array([np.nan])
        recording_s = self._recording_s(self.attempts)
        adopted_s = self._recording_s([attempt for attempt in self.attempts if attempt.adopted])
        # A rejected attempt without pictures has no error; a demonstration's NaN must show.
        sync_errors_s = [
            attempt.sync_error_max_s
            for attempt in self.attempts
            if attempt.kept or np.isfinite(attempt.sync_error_max_s)
        ]
        episodes_n = len(self.kept)
        return {
            "episodes": episodes_n,
            "attempts": len(self.attempts),
            "success_rate": float(np.mean([attempt.success for attempt in self.attempts])),
            "schema_ok": bool(self.kept) and not any(attempt.faults for attempt in self.kept),
            "jerk_rms_max": max(quality.rms_jerk_rad_s3 for quality in qualities),
            "sync_error_max_s": float(np.max(sync_errors_s)),
            "latency_p50_s": float(np.percentile(latencies_s, 50)),
            "latency_p99_s": float(np.percentile(latencies_s, 99)),
            "lag_p50_s": float(np.percentile(lags_s, 50)),
            "lag_p99_s": float(np.percentile(lags_s, 99)),
            "episodes_per_min": 60.0 * episodes_n / max(recording_s, adopted_s + elapsed_s),
            "recorded_per_min": 60.0 * episodes_n / recording_s,
            "recorded_ticks": sum(quality.ticks for quality in qualities),
        }

    def _recording_s(self, attempts: Sequence[Attempt]) -> float:
        return sum(attempt.wall_s for attempt in attempts) / self.workers


def attempts_of(
    job: Job,
    workers: int,
    observe: Observe | None = None,
) -> Generator[Attempt]:
    """Yield attempts in order.

    They end when there are `episodes_n` demonstrations or the attempts allowed are used up.
    Attempts that an interrupted recording left in `job.folder` count (see `claim`). `observe` needs
    one worker.

    Raises:
        UsageError, HandoverError: The leader is unknown, displaced or refused.
        EnvironmentMissingError: Missing device or renderer.
    """
    processes = usable_workers(job, workers)
    try:
        yield from _rounds(job, processes, observe)
    finally:
        if led_by_person(job):
            _close_rigs()  # gives the terminal or the device back


def _attempts_max(job: Job) -> int:
    """Return the most attempts: a person makes as many as they like."""
    teleop = job.teleop
    if not led_by_person(job):
        return math.ceil(teleop.episodes_n * teleop.attempts_max_ratio)
    if teleop.person.attempts_max is None:
        return sys.maxsize
    return teleop.person.attempts_max


def _rounds(job: Job, processes: int, observe: Observe | None) -> Iterator[Attempt]:
    allowed = _attempts_max(job)
    tried = 0
    missing = job.teleop.episodes_n
    while missing > 0 and tried < allowed:
        indices = range(tried, min(tried + missing, allowed))
        for attempt in in_workers(
            lambda index: _record_in_worker(job, index, observe),
            indices,
            processes,
        ):
            tried += 1
            missing -= int(attempt.kept)
            yield attempt


def recording_of(job: Job, workers: int, attempts: Sequence[Attempt]) -> RecordedAttempts:
    """Return the recording, with the faults that only all attempts show."""
    references = camera_references([attempt.views for attempt in attempts if attempt.kept])
    judged: list[Attempt] = []
    for attempt in attempts:
        swapped = map(str, check_swapped(attempt.views, references))
        judged.append(replace(attempt, faults=(*attempt.faults, *swapped)))
    processes = min(usable_workers(job, workers), job.teleop.episodes_n)
    return RecordedAttempts(tuple(judged), processes)


def record(job: Job, *, workers: int) -> RecordedAttempts:
    """See `attempts_of`."""
    return recording_of(job, workers, list(attempts_of(job, workers)))
