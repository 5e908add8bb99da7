"""Record trials to files, one or many, over processes: what the `teleop-record` stage runs.

The number of workers changes nothing but the time: each trial is drawn from its own number, runs in its own
episode of simulated time, and attempts are made in rounds of known size, in order.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from minidual.config.arbiter import ArbiterConfig
from minidual.config.scene import SceneConfig
from minidual.config.teleop import TeleopConfig
from minidual.data import durable
from minidual.data.episode import EpisodeWriter, read_episode
from minidual.data.quality import EpisodeQuality, episode_quality
from minidual.data.schema import EpisodeMeta
from minidual.data.smoothness import rms_jerk
from minidual.data.validate import validate_episode
from minidual.robot.constants import Q_LOWER, Q_UPPER, Array
from minidual.robot.kinematics import Kinematics
from minidual.sim.render import Camera, Image, write_video
from minidual.sim.world import SimulationDivergedError, World
from minidual.tasks.operator import ScriptedOperator
from minidual.tasks.rod_carry import RodTrial, sample_trial
from minidual.teleop.leader import IN_PROCESS, LeaderSetup, make_leader, require_leader
from minidual.teleop.observation import Observer
from minidual.teleop.session import SessionResult, TeleopSession, Tick

PURPOSE = "demonstrations"
"""Random stream of the trials; no test draws from it."""
TASK = "Grasp the orange rod with both hands, carry it to the green mark and put it down."
KEPT, REJECTED = "episodes", "rejected"
FILM_SIZE = (640, 480)


@dataclass(frozen=True)
class Job:
    """What a recording needs to know; the same for all its trials."""

    folder: Path
    scene: SceneConfig
    teleop: TeleopConfig
    arbiter: ArbiterConfig
    seed: int

    def trial(self, index: int) -> RodTrial:
        """Return trial `index` of the demonstrations."""
        return sample_trial(self.scene, self.seed, PURPOSE, index, widen=self.teleop.widen)


@dataclass(frozen=True)
class Attempt:
    """One trial that was led, and what became of it.

    Attributes:
        trial: Its number and start.
        success: Whether the task was achieved.
        kept: Whether it is a demonstration.
        reason: Why not, or an empty string.
        path: Its file, or None if none was written.
        quality: Measures of the recording; None without a file.
        goal_error_m: Distance of the rod from its goal at the end.
        tilt_max_rad: Largest tilt of the rod.
        completion_s: When the rod lay released at its goal.
        sync_error_max_s: Largest time between joints and pictures of a tick, read back from the file.
        problems: Faults of the file, read back.
        latencies_s: Wall-clock time of each tick from reading the leader to its torque.
        wall_s: Wall-clock time of the attempt: planned, led, written and read back.
    """

    trial: RodTrial
    success: bool
    kept: bool
    reason: str
    path: Path | None = None
    quality: EpisodeQuality | None = None
    goal_error_m: float = float("nan")
    tilt_max_rad: float = float("nan")
    completion_s: float = float("nan")
    sync_error_max_s: float = float("nan")
    problems: tuple[str, ...] = ()
    latencies_s: Array | None = None
    wall_s: float = 0.0


class Rig:
    """World, operator and session, built once a process and used for many trials."""

    def __init__(self, job: Job, cameras: Sequence[str]) -> None:
        self.job = job
        kinematics = Kinematics()
        self.world = World(job.scene, visuals=True)
        self.observer = Observer(self.world, cameras)
        self.session = TeleopSession(self.world, kinematics, self.observer, job.teleop, job.arbiter)
        operator = ScriptedOperator(job.scene, job.teleop.operator)
        self._setup = LeaderSetup(job.scene, job.teleop, job.seed, operator)

    def lead(self, trial: RodTrial, *, on_tick: Callable[[int, Tick], None] | None = None) -> SessionResult:
        """Run one episode."""
        leader = make_leader(self.job.teleop.leader, self._setup, trial)
        try:
            return self.session.run(trial, leader, on_tick=on_tick)
        finally:
            leader.close()

    def record(self, index: int) -> Attempt:
        """Run trial `index`, write it to its file and look at what was written.

        The file is written among the rejected ones and moves to the demonstrations when it is whole and good,
        so at no instant does an unfinished or failed attempt stand among those.
        """
        trial = self.job.trial(index)
        name = f"episode_{trial.index:06d}.hdf5"
        with EpisodeWriter(self.job.folder / REJECTED / name, self._meta(trial)) as writer:
            try:
                result = self.lead(trial, on_tick=lambda k, tick: _append(writer, tick))
            except SimulationDivergedError as error:
                return Attempt(trial, False, False, error.message)
            success = result.outcome.success and result.ended_by == "leader"
            reason = self._reason(result, success=success)
            if reason and (not self.job.teleop.keep_rejected or _is_empty(result, self.job.teleop.rate_hz)):
                return Attempt(trial, success, False, reason, latencies_s=result.latencies_s)
            outcome = result.outcome
            facts = {
                "reason": reason, "goal_error_m": outcome.goal_error_m, "tilt_max_rad": outcome.tilt_max_rad,
                "completion_s": outcome.duration_s,
            }  # fmt: skip
            path = writer.commit(success=success, extra=facts)
        if not reason:
            target = self.job.folder / KEPT / name
            target.parent.mkdir(exist_ok=True)
            path = path.rename(target)
            durable.fsync_dir(target.parent)
        return self._examined(trial, result, path, success=success, kept=not reason, reason=reason)

    def _meta(self, trial: RodTrial) -> EpisodeMeta:
        teleop = self.job.teleop
        return EpisodeMeta(
            fps=teleop.rate_hz, task=TASK, seed=self.job.seed, cameras=teleop.cameras,
            extra={
                "trial": trial.index, "purpose": trial.purpose, "leader": teleop.leader,
                "start_x_y_yaw": list(trial.start), "goal_x_y_yaw": list(trial.goal),
            },
        )  # fmt: skip

    def _reason(self, result: SessionResult, *, success: bool) -> str:
        """Return why an episode is no demonstration, or an empty string."""
        if not success or result.refusals:
            return result.reason or "the leader did not end the episode in time"
        jerk, limit = rms_jerk(result.q, self.job.teleop.rate_hz), self.job.teleop.jerk_max_rad_s3
        return "" if jerk <= limit else f"RMS jerk {jerk:.0f} rad/s^3, limit {limit:.0f}"

    def _examined(
        self, trial: RodTrial, result: SessionResult, path: Path, *, success: bool, kept: bool, reason: str
    ) -> Attempt:
        """Open the file again: what counts is what is on the disk."""
        problems = validate_episode(path, cameras=self.job.teleop.cameras, lower=Q_LOWER, upper=Q_UPPER)
        episode = read_episode(path, cameras=())
        sync = float("nan")
        if episode.image_timestamps is not None:
            sync = float(np.max(np.abs(episode.image_timestamps - episode.timestamps)))
        return Attempt(
            trial, success, kept, reason, path, episode_quality(episode), result.outcome.goal_error_m,
            result.outcome.tilt_max_rad, result.outcome.duration_s, sync, tuple(map(str, problems)),
            result.latencies_s,
        )  # fmt: skip

    def close(self) -> None:
        """Free the rendering context."""
        self.observer.close()


def _is_empty(result: SessionResult, rate_hz: float) -> bool:
    """Return whether an episode shows nothing to keep or to measure: ended at once, or nobody moved."""
    return len(result.q) / rate_hz < 1.0 or float(np.ptp(result.q, axis=0).max()) < 1e-3


def _append(writer: EpisodeWriter, tick: Tick) -> None:
    seen = tick.observation
    writer.append(
        qpos=seen.q, qvel=seen.v, gripper=seen.gripper, action=tick.action, action_gripper=tick.action_gripper,
        timestamp=seen.time_s, images=seen.images, image_timestamp=seen.time_s,
    )  # fmt: skip


_rigs: dict[str, Rig] = {}


def _record_in_worker(job: Job, index: int) -> Attempt:
    key = f"{job.folder}/{job.seed}/{job.teleop}/{job.scene}/{job.arbiter}"
    if key not in _rigs:
        for rig in _rigs.values():
            rig.close()
        _rigs.clear()
        _rigs[key] = Rig(job, job.teleop.cameras)
    began = time.perf_counter()
    attempt = _rigs[key].record(index)
    return replace(attempt, wall_s=time.perf_counter() - began)


def usable_workers(job: Job, workers: int) -> int:
    """Return over how many processes a recording can be spread: one, if the leader needs this one's terminal."""
    return 1 if job.teleop.leader in IN_PROCESS else workers


def record_attempts(job: Job, indices: Sequence[int], *, workers: int) -> Iterator[Attempt]:
    """Record trials over processes and yield what became of them, in the order of `indices`."""
    import joblib

    # One numeric thread a process: on a busy machine more of them only wait for each other.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    os.environ.setdefault("LP_NUM_THREADS", "0")  # the software renderer draws in the calling thread
    processes = min(usable_workers(job, workers), max(1, len(indices)))
    yield from joblib.Parallel(
        n_jobs=processes, return_as="generator", batch_size=1, pre_dispatch="2*n_jobs"
    )(joblib.delayed(_record_in_worker)(job, index) for index in indices)


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


def record(job: Job, *, workers: int, on_attempt: Callable[[Attempt], None] | None = None) -> Recording:
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
        for attempt in record_attempts(job, range(start, min(start + missing, allowed)), workers=workers):
            attempts.append(attempt)
            if on_attempt is not None:
                on_attempt(attempt)
    if all(a.path is None or a.kept for a in attempts):
        durable.remove(job.folder / REJECTED)
    return Recording(tuple(attempts), time.perf_counter() - began, min(usable_workers(job, workers), wanted))


def film(job: Job, index: int, path: Path) -> SessionResult:
    """Run trial `index` once more, seen by the overview camera, and write it to an mp4."""
    rig = Rig(job, ())
    frames: list[Image] = []
    every = max(1, round(job.teleop.rate_hz / 25.0))
    with Camera(rig.world.model, *FILM_SIZE, shadows=True) as camera:

        def shoot(k: int, tick: Tick) -> None:
            if k % every == 0:
                frames.append(camera.picture(rig.world.data, "overview").copy())

        result = rig.lead(job.trial(index), on_tick=shoot)
    rig.close()
    write_video(path, frames, fps=round(job.teleop.rate_hz / every))
    return result


def quality_row(attempt: Attempt) -> dict[str, Any]:
    """Return an attempt as one flat row for CSV."""
    x, y, yaw = attempt.trial.start
    row: dict[str, Any] = {
        "trial": attempt.trial.index, "start_x_m": x, "start_y_m": y, "start_yaw_rad": yaw,
        "success": attempt.success, "kept": attempt.kept, "reason": attempt.reason,
        "completion_s": attempt.completion_s, "goal_error_m": attempt.goal_error_m,
        "tilt_max_rad": attempt.tilt_max_rad, "file": "", "ticks": 0, "duration_s": "", "rms_jerk_rad_s3": "",
        "path_length_m": "", "path_efficiency": "", "cells_n": "",
    }  # fmt: skip
    if attempt.quality is not None:
        row.update({k: v for k, v in attempt.quality.to_dict().items() if k in row and k != "success"})
    return {k: round(v, 6) if isinstance(v, float) else v for k, v in row.items()}
