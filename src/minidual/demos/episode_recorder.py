"""Writes the episodes of a job, reads them back and judges them."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from minidual import durable
from minidual.collision.errors import PlanningError
from minidual.demos.attempt import KEPT, REJECTED, Attempt, AttemptFiles
from minidual.demos.checks import thumbnails
from minidual.demos.episode import inspect_episode
from minidual.demos.job import Job
from minidual.demos.lag import leader_lag
from minidual.demos.leader import Leader
from minidual.demos.link.linked_leader import LinkedLeader
from minidual.demos.quality import episode_quality, rms_jerk
from minidual.demos.schema import EpisodeMeta
from minidual.demos.session import SessionResult, Tick
from minidual.demos.writer import EpisodeWriter
from minidual.plant.world import SimulationDivergedError
from minidual.robot.kinematics import Kinematics
from minidual.tasks.judge import Outcome
from minidual.tasks.task import Trial, placement

MOTION_MIN_RAD = 1e-3
"""A failed episode in which no joint moves further, or under 1 s long, is not written."""


class Performer(Protocol):
    """Runs the episodes that are recorded; see `demos.rig.Rig`."""

    @property
    def leader(self) -> Leader | None:
        """The leader, None before the first episode."""
        ...

    def lead(self, trial: Trial, on_tick: Callable[[Tick], None]) -> SessionResult:
        """Run one episode."""
        ...


class EpisodeRecorder:
    """Records trials of a job, each as an attempt with its files."""

    def __init__(self, job: Job, kinematics: Kinematics) -> None:
        self._job = job
        self._kinematics = kinematics
        self._files = AttemptFiles(job.folder)

    def adopted(self, trial: Trial) -> Attempt | None:
        """Return the attempt of an interrupted recording if its files are whole."""
        attempt = self._files.read(trial)
        if attempt is None or attempt.path is None:
            return attempt
        if not attempt.path.exists():  # killed before the file got its name
            return None
        judged = self.read_back(attempt, attempt.path)
        if judged.kept != attempt.kept:  # the file was damaged since
            durable.set_aside(attempt.path, attempt.path.name)
            return None
        return judged

    def record(self, trial: Trial, performer: Performer) -> Attempt:
        """Run a trial, again and again while the leader discards the episode.

        An episode's file gets its name after it was read back and the attempt's JSON file was
        written.
        """
        attempt = None
        while attempt is None:
            attempt = self._record_once(trial, performer)
        return attempt

    def _record_once(self, trial: Trial, performer: Performer) -> Attempt | None:
        """Return the attempt, None if it was thrown away."""
        began = time.perf_counter()
        folder = self._job.folder
        name = AttemptFiles.episode_name(trial.index)
        with EpisodeWriter(folder / REJECTED / name, self._meta(trial)) as writer:
            try:
                result = performer.lead(trial, lambda tick: writer.append(**tick.values()))
            except (SimulationDivergedError, PlanningError) as error:
                reason = error.message.splitlines()[0]
                failed = Attempt(trial, success=False, reason=reason)
                return self._concluded(failed, performer.leader, began)
            if result.ended_by == "discard":
                return None
            leader = performer.leader
            attempt = Attempt(
                trial,
                success=result.success,
                reason=self._reason(result),
                measures={**_measures(result.outcome), **_link_measures(leader)},
                latencies_s=result.latencies_s,
            )
            is_unwanted = result.ended_by == "next" or self._is_empty(result)
            if attempt.reason and is_unwanted:
                return self._concluded(attempt, leader, began)
            facts = {} if leader is None else leader.facts
            partial = writer.finish(
                success=result.success,
                extra={"reason": attempt.reason, **attempt.measures, **facts},
            )
            attempt = self.read_back(attempt, partial)
            path = folder / (KEPT if attempt.kept else REJECTED) / name
            attempt = self._concluded(replace(attempt, path=path), leader, began)
            writer.publish(path)
            return attempt

    def _is_empty(self, result: SessionResult) -> bool:
        """Return whether an episode lasts under a second, or no joint moves."""
        if len(result.q) < self._job.teleop.rate_hz:
            return True
        return float(np.ptp(result.q, axis=0).max()) < MOTION_MIN_RAD

    def _reason(self, result: SessionResult) -> str:
        """Return why an episode is no demonstration, or ""."""
        if result.reason:
            return result.reason
        jerk = rms_jerk(result.q, self._job.teleop.rate_hz)
        limit = self._job.teleop.jerk_max_rad_s3
        if jerk <= limit:
            return ""
        return f"RMS jerk {jerk:.0f} rad/s^3, limit {limit:.0f}"

    def read_back(self, attempt: Attempt, path: Path) -> Attempt:
        """Return the attempt with the facts and faults of its file."""
        camera = self._job.task.config.scene.camera
        episode, faults = inspect_episode(
            path,
            cameras=self._job.teleop.cameras,
            size=(camera.height_px, camera.width_px),
            robot=self._job.robot,
        )
        names = tuple(map(str, faults))
        reason = attempt.reason
        if not reason and names:
            reason = names[0]
        attempt = replace(attempt, faults=names, reason=reason)
        if episode is None:
            return attempt
        if episode.image_timestamps is not None:
            sync_errors_s = np.abs(episode.image_timestamps - episode.timestamps)
            attempt = replace(attempt, sync_error_max_s=float(np.max(sync_errors_s)))
        if faults:
            return attempt
        lag = leader_lag(episode.action, episode.qpos, episode.meta.fps)
        measures = dict(attempt.measures)
        if np.isfinite(lag.aligned_s):
            measures["lag_s"] = lag.aligned_s
        return replace(
            attempt,
            lag=lag,
            measures=measures,
            quality=episode_quality(episode, self._kinematics),
            views=thumbnails(episode.images),
        )

    def _concluded(self, attempt: Attempt, leader: Leader | None, began: float) -> Attempt:
        """Return the attempt with its wall time, and write its JSON file and that of its link."""
        attempt = replace(attempt, wall_s=time.perf_counter() - began)
        if isinstance(leader, LinkedLeader) and leader.ticks:
            path = self._files.link_path(attempt.trial.index)
            durable.make_folder(path.parent)
            durable.write_csv(path, leader.rows())
        self._files.write(attempt)
        return attempt

    def _meta(self, trial: Trial) -> EpisodeMeta:
        teleop = self._job.teleop
        task = self._job.task
        extra: dict[str, object] = {
            "trial": trial.index,
            "purpose": trial.purpose,
            "leader": teleop.leader,
            "start_x_y_yaw": list(placement(trial.start[task.carried])),
            "goal_x_y_yaw": list(placement(trial.goal[task.carried])),
        }
        if teleop.correct:
            extra["corrects"] = Path(teleop.correct).name
        room = self._job.room(trial)
        if teleop.link.network:
            extra["network"] = teleop.link.network
        if room is not None:
            extra["condition"] = room[0]
            extra["room_change_s"] = teleop.room_change_s
        return EpisodeMeta(
            fps=teleop.rate_hz,
            task=task.instruction,
            seed=self._job.seed,
            cameras=teleop.cameras,
            extra=extra,
        )


def _link_measures(leader: Leader | None) -> dict[str, float]:
    """Return the measures of the link in the episode; {} without one."""
    return leader.measures() if isinstance(leader, LinkedLeader) else {}


def _measures(outcome: Outcome) -> dict[str, float]:
    """Return the outcome's finite measures."""
    measures = {"completion_s": outcome.duration_s}
    for name in ("goal_error_m", "tilt_max_rad"):
        value = outcome.number(name)
        if np.isfinite(value):
            measures[name] = value
    return measures
