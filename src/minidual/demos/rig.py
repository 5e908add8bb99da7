"""Run and write one demonstration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from minidual import durable
from minidual.config.arbiter import ArbiterConfig
from minidual.config.supervisor import SupervisorConfig
from minidual.config.teleop import TeleopConfig
from minidual.demos.checks import Thumbnails, thumbnails
from minidual.demos.episode import inspect_episode
from minidual.demos.leader import LEADERS, LeaderSetup
from minidual.demos.observation import Observer
from minidual.demos.quality import EpisodeQuality, episode_quality
from minidual.demos.schema import EpisodeMeta
from minidual.demos.session import SessionResult, TeleopSession, Tick
from minidual.demos.smoothness import rms_jerk
from minidual.demos.writer import EpisodeWriter
from minidual.plant.render import Camera, Image, write_video
from minidual.plant.world import SimulationDivergedError, World
from minidual.robot.arms import robot_from
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot
from minidual.skills.supervised import trial_supervisor
from minidual.tasks.judge import Outcome
from minidual.tasks.rod_carry import placement
from minidual.tasks.task import Task, Trial

PURPOSE = "demonstrations"
"""Random stream, not used by tests."""
KEPT, REJECTED = "episodes", "rejected"
FILM_SIZE = (640, 480)


@dataclass(frozen=True)
class Job:
    """Inputs shared by all trials."""

    folder: Path
    task: Task
    teleop: TeleopConfig
    arbiter: ArbiterConfig
    seed: int
    supervisor: SupervisorConfig = field(default_factory=SupervisorConfig)

    @property
    def robot(self) -> Robot:
        """The arms."""
        return robot_from(self.task.config.robot)

    def trial(self, index: int) -> Trial:
        """Return trial `index`."""
        return self.task.trial(self.seed, PURPOSE, index, widen=self.teleop.widen)


@dataclass(frozen=True)
class Attempt:
    """One trial that was run.

    Attributes:
        kept: Whether it is a demonstration.
        reason: Why not, or "".
        path: File, if written.
        sync_error_max_s: As read back.
        problems: Faults read back.
        views: Start images.
        latencies_s: Wall time per tick from reading the leader to its torque.
        wall_s: Wall time to plan, run, write and read back.
    """

    trial: Trial
    success: bool
    kept: bool
    reason: str
    path: Path | None = None
    outcome: Outcome | None = None
    quality: EpisodeQuality | None = None
    sync_error_max_s: float = float("nan")
    problems: tuple[str, ...] = ()
    views: Thumbnails = field(default_factory=dict)
    latencies_s: Array | None = None
    wall_s: float = 0.0

    def row(self) -> dict[str, Any]:
        """Return a flat CSV row."""
        x, y, yaw = placement(next(iter(self.trial.start.values())))
        row: dict[str, Any] = {"trial": self.trial.index, "start_x_m": x, "start_y_m": y, "start_yaw_rad": yaw}
        row |= {"success": self.success, "kept": self.kept, "reason": self.reason}
        row |= measures(self.outcome)
        names = EpisodeQuality.__dataclass_fields__
        row |= dict.fromkeys(names, "") if self.quality is None else asdict(self.quality)
        return {key: round(value, 6) if isinstance(value, float) else value for key, value in row.items()}


def measures(outcome: Outcome | None) -> dict[str, float]:
    """Return the recorded numbers; NaN without outcome."""
    if outcome is None:
        return dict.fromkeys(("completion_s", "goal_error_m", "tilt_max_rad"), float("nan"))
    return {
        "completion_s": outcome.duration_s,
        "goal_error_m": outcome.goal_error_m,
        "tilt_max_rad": outcome.tilt_max_rad,
    }


class Rig:
    """World and session of one process."""

    def __init__(self, job: Job, cameras: Sequence[str]) -> None:
        self.job = job
        self.kinematics = Kinematics(job.robot)
        self.world = World(job.task.scene, job.robot, visuals=True)
        self.observer = Observer(self.world, cameras)
        supervisor = trial_supervisor(job.supervisor, self.world.dt, job.robot)
        self.session = TeleopSession(
            self.world, self.kinematics, self.observer, job.teleop, job.arbiter, supervisor=supervisor
        )
        self._setup = LeaderSetup(job.robot, job.task, job.teleop, job.seed)

    def lead(self, trial: Trial, *, on_tick: Callable[[int, Tick], None] | None = None) -> SessionResult:
        """Run one episode."""
        leader = LEADERS[self.job.teleop.leader].for_trial(self._setup, trial)
        try:
            return self.session.run(self.job.task, trial, leader, on_tick=on_tick)
        finally:
            leader.close()

    def record(self, index: int) -> Attempt:
        """Run trial `index`, write its file, and read it back.

        Files are written to `rejected` and moved if accepted, so demonstrations are always complete.
        """
        job, trial = self.job, self.job.trial(index)
        name = f"episode_{trial.index:06d}.hdf5"
        with EpisodeWriter(job.folder / REJECTED / name, self._meta(trial)) as writer:
            try:
                result = self.lead(trial, on_tick=lambda k, tick: _append(writer, tick))
            except SimulationDivergedError as error:
                return Attempt(trial, False, False, error.message)
            success = result.outcome.success and result.ended_by == "leader"
            reason = self._reason(result, success=success)
            if reason and (not job.teleop.keep_rejected or _is_empty(result, job.teleop.rate_hz)):
                return Attempt(trial, success, False, reason, latencies_s=result.latencies_s)
            path = writer.commit(success=success, extra={"reason": reason, **measures(result.outcome)})
        if not reason:
            target = job.folder / KEPT / name
            target.parent.mkdir(exist_ok=True)
            path = path.rename(target)
            durable.sync(target.parent)
        # Judge what is on disk.
        episode, problems = inspect_episode(path, cameras=job.teleop.cameras, robot=job.robot)
        faults = tuple(map(str, problems))
        attempt = Attempt(
            trial, success, not reason, reason, path, result.outcome, problems=faults, latencies_s=result.latencies_s
        )
        if episode is None:
            return attempt
        quality = episode_quality(episode, self.kinematics)
        views = thumbnails(episode.images)
        return replace(attempt, quality=quality, sync_error_max_s=episode.sync_error_max_s, views=views)

    def _meta(self, trial: Trial) -> EpisodeMeta:
        teleop, task = self.job.teleop, self.job.task
        extra = {
            "trial": trial.index,
            "purpose": trial.purpose,
            "leader": teleop.leader,
            "start_x_y_yaw": list(placement(trial.start[task.carried])),
            "goal_x_y_yaw": list(placement(trial.goal[task.carried])),
        }
        return EpisodeMeta(teleop.rate_hz, task.instruction, self.job.seed, teleop.cameras, extra=extra)

    def _reason(self, result: SessionResult, *, success: bool) -> str:
        if not success or result.refusals:
            return result.reason or "the leader did not end the episode in time"
        jerk, limit = rms_jerk(result.q, self.job.teleop.rate_hz), self.job.teleop.jerk_max_rad_s3
        return "" if jerk <= limit else f"RMS jerk {jerk:.0f} rad/s^3, limit {limit:.0f}"

    def close(self) -> None:
        """Free the renderer."""
        self.observer.close()


def _is_empty(result: SessionResult, rate_hz: float) -> bool:
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


def film(job: Job, index: int, path: Path) -> None:
    """Run trial `index` again and film it."""
    rig = Rig(job, ())
    frames: list[Image] = []
    every = max(1, round(job.teleop.rate_hz / 25.0))
    with Camera(rig.world.model, *FILM_SIZE, shadows=True) as camera:

        def shoot(k: int, tick: Tick) -> None:
            if k % every == 0:
                frames.append(camera.picture(rig.world.data, "overview").copy())

        rig.lead(job.trial(index), on_tick=shoot)
    rig.close()
    write_video(path, frames, fps=round(job.teleop.rate_hz / every))
