"""One trial led and written to its file: the rig that a process of the `teleop-record` stage builds once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from minidual import durable
from minidual.config.arbiter import ArbiterConfig
from minidual.config.supervisor import SupervisorConfig
from minidual.config.teleop import TeleopConfig
from minidual.demos.episode import EpisodeWriter, read_episode
from minidual.demos.leader import LeaderSetup, make_leader
from minidual.demos.observation import Observer
from minidual.demos.quality import EpisodeQuality, episode_quality
from minidual.demos.schema import EpisodeMeta
from minidual.demos.session import SessionResult, TeleopSession, Tick
from minidual.demos.smoothness import rms_jerk
from minidual.demos.validate import validate_episode
from minidual.plant.render import Camera, Image, write_video
from minidual.plant.world import SimulationDivergedError, World
from minidual.robot.constants import Q_LOWER, Q_UPPER, Array
from minidual.robot.kinematics import Kinematics
from minidual.skills.operator import ScriptedOperator
from minidual.skills.supervised import trial_supervisor
from minidual.tasks.rod_carry import placement
from minidual.tasks.task import Task, Trial

PURPOSE = "demonstrations"
"""Random stream of the trials; no test draws from it."""
KEPT, REJECTED = "episodes", "rejected"
FILM_SIZE = (640, 480)


@dataclass(frozen=True)
class Job:
    """What a recording needs to know; the same for all its trials."""

    folder: Path
    task: Task
    teleop: TeleopConfig
    arbiter: ArbiterConfig
    seed: int
    supervisor: SupervisorConfig = field(default_factory=SupervisorConfig)

    def trial(self, index: int) -> Trial:
        """Return trial `index` of the demonstrations."""
        return self.task.trial(self.seed, PURPOSE, index, widen=self.teleop.widen)


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

    trial: Trial
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
        self.kinematics = kinematics = Kinematics()
        self.world = World(job.task.scene, visuals=True)
        self.observer = Observer(self.world, cameras)
        self.session = TeleopSession(
            self.world,
            kinematics,
            self.observer,
            job.teleop,
            job.arbiter,
            supervisor=trial_supervisor(job.supervisor, self.world.dt, self.world.robot),
        )
        operator = ScriptedOperator(job.task.scene, job.teleop.operator)
        self._setup = LeaderSetup(job.task.scene, job.teleop, job.seed, operator)

    def lead(self, trial: Trial, *, on_tick: Callable[[int, Tick], None] | None = None) -> SessionResult:
        """Run one episode."""
        leader = make_leader(self.job.teleop.leader, self._setup, trial)
        try:
            return self.session.run(self.job.task, trial, leader, on_tick=on_tick)
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
                "reason": reason,
                "goal_error_m": outcome.goal_error_m,
                "tilt_max_rad": outcome.tilt_max_rad,
                "completion_s": outcome.duration_s,
            }
            path = writer.commit(success=success, extra=facts)
        if not reason:
            target = self.job.folder / KEPT / name
            target.parent.mkdir(exist_ok=True)
            path = path.rename(target)
            durable.sync(target.parent)
        return self._examined(trial, result, path, success=success, kept=not reason, reason=reason)

    def _meta(self, trial: Trial) -> EpisodeMeta:
        teleop = self.job.teleop
        return EpisodeMeta(
            fps=teleop.rate_hz,
            task=self.job.task.instruction,
            seed=self.job.seed,
            cameras=teleop.cameras,
            extra={
                "trial": trial.index,
                "purpose": trial.purpose,
                "leader": teleop.leader,
                "start_x_y_yaw": list(placement(trial.start[self.job.task.carried])),
                "goal_x_y_yaw": list(placement(trial.goal[self.job.task.carried])),
            },
        )

    def _reason(self, result: SessionResult, *, success: bool) -> str:
        """Return why an episode is no demonstration, or an empty string."""
        if not success or result.refusals:
            return result.reason or "the leader did not end the episode in time"
        jerk, limit = rms_jerk(result.q, self.job.teleop.rate_hz), self.job.teleop.jerk_max_rad_s3
        return "" if jerk <= limit else f"RMS jerk {jerk:.0f} rad/s^3, limit {limit:.0f}"

    def _examined(
        self, trial: Trial, result: SessionResult, path: Path, *, success: bool, kept: bool, reason: str
    ) -> Attempt:
        """Open the file again: what counts is what is on the disk."""
        problems = validate_episode(path, cameras=self.job.teleop.cameras, lower=Q_LOWER, upper=Q_UPPER)
        episode = read_episode(path, cameras=())
        sync = float("nan")
        if episode.image_timestamps is not None:
            sync = float(np.max(np.abs(episode.image_timestamps - episode.timestamps)))
        return Attempt(
            trial,
            success,
            kept,
            reason,
            path,
            episode_quality(episode),
            result.outcome.goal_error_m,
            result.outcome.tilt_max_rad,
            result.outcome.duration_s,
            sync,
            tuple(map(str, problems)),
            result.latencies_s,
        )

    def close(self) -> None:
        """Free the rendering context."""
        self.observer.close()


def _is_empty(result: SessionResult, rate_hz: float) -> bool:
    """Return whether an episode shows nothing to keep or to measure: ended at once, or nobody moved."""
    return len(result.q) / rate_hz < 1.0 or float(np.ptp(result.q, axis=0).max()) < 1e-3


def _append(writer: EpisodeWriter, tick: Tick) -> None:
    seen = tick.observation
    writer.append(
        qpos=seen.q,
        qvel=seen.v,
        gripper=seen.gripper,
        action=tick.action,
        action_gripper=tick.action_gripper,
        timestamp=seen.time_s,
        images=seen.images,
        image_timestamp=seen.time_s,
    )


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
