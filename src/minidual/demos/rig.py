"""Run and write one demonstration."""

import itertools
import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from pydantic import Field, ValidationError

from minidual import durable
from minidual.collision.errors import PlanningError
from minidual.config.base import StrictModel
from minidual.config.control import ArbiterConfig, SupervisorConfig
from minidual.config.learning import TeleopConfig
from minidual.config.seeds import stream
from minidual.control.stack import ControlStack
from minidual.demos.checks import Thumbnails, thumbnails
from minidual.demos.episode import inspect_episode
from minidual.demos.leader import LEADERS, LeaderSetup
from minidual.demos.quality import EpisodeQuality, episode_quality, rms_jerk
from minidual.demos.schema import EpisodeMeta
from minidual.demos.session import SessionResult, TeleopSession, Tick
from minidual.demos.writer import EpisodeWriter
from minidual.errors import DataError
from minidual.plant.render import Camera, Image
from minidual.plant.world import SimulationDivergedError, World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Robot, robot_from
from minidual.skills.supervised import trial_supervisor
from minidual.tasks.task import Task, Trial, placement

PURPOSE = "demonstrations"
"""Random stream, not used by tests."""
KEPT = "episodes"
REJECTED = "rejected"
ATTEMPTS = "attempts"
"""Folders of a recording: demonstrations, other episodes, and one JSON file for each attempt."""
MEASURES = ("completion_s", "goal_error_m", "tilt_max_rad")


class _Said(StrictModel):
    """An attempt's JSON file."""

    success: bool
    reason: str
    measures: dict[str, float]
    latencies_s: tuple[float, ...]
    wall_s: float
    path: str | None = Field(pattern=rf"^({KEPT}|{REJECTED})/episode_\d{{6}}\.hdf5$")


type Room = tuple[
    str,
    Callable[[mujoco.MjModel, Task, Trial, np.random.Generator], AbstractContextManager[None]],
]
"""Name, and a context that changes what the cameras see of a compiled model, then restores it."""


@dataclass(frozen=True)
class Job:
    """Inputs shared by all trials; they take turns in `rooms`."""

    folder: Path
    task: Task
    teleop: TeleopConfig
    arbiter: ArbiterConfig
    seed: int
    supervisor: SupervisorConfig = field(default_factory=SupervisorConfig)
    rooms: tuple[Room, ...] = ()

    @property
    def robot(self) -> Robot:
        """The arms."""
        return robot_from(self.task.config.robot)

    def trial(self, index: int) -> Trial:
        """Return trial `index`."""
        return self.task.trial(self.seed, PURPOSE, index, widen=self.teleop.widen)

    def room(self, trial: Trial, turn: int = 0) -> Room | None:
        """Return a trial's room; `turn` counts changes of room within it."""
        return self.rooms[(trial.index + turn) % len(self.rooms)] if self.rooms else None


@dataclass(frozen=True)
class Attempt:
    """One trial that was run.

    Attributes:
        reason: Why it is no demonstration, or "".
        latencies_s: Wall time per tick, see `SessionResult`.
        wall_s: Wall time to plan, run, write and read back.
        adopted: Whether an interrupted recording ran it.
        quality, sync_error_max_s, faults, views: Of the file, read back; `views` are thumbnails.
    """

    trial: Trial
    success: bool
    reason: str
    path: Path | None = None
    measures: Mapping[str, float] = field(default_factory=dict)
    latencies_s: Sequence[float] = ()
    wall_s: float = 0.0
    adopted: bool = False
    quality: EpisodeQuality | None = None
    sync_error_max_s: float = float("nan")
    faults: tuple[str, ...] = ()
    views: Thumbnails = field(default_factory=dict)

    @property
    def kept(self) -> bool:
        """Whether it became a demonstration."""
        return not self.reason

    def row(self) -> dict[str, Any]:
        """Return a flat CSV row."""
        x, y, yaw = placement(next(iter(self.trial.start.values())))
        row: dict[str, Any] = {
            "trial": self.trial.index,
            "start_x_m": x,
            "start_y_m": y,
            "start_yaw_rad": yaw,
        }
        row |= {"success": self.success, "kept": self.kept, "reason": self.reason}
        row |= dict.fromkeys(MEASURES, float("nan")) | dict(self.measures)
        row["file"] = self.path.name if self.path and self.quality else ""
        row |= (
            dict.fromkeys(EpisodeQuality._fields, "")
            if self.quality is None
            else self.quality._asdict()
        )
        return {
            key: round(value, 6) if isinstance(value, float) else value
            for key, value in row.items()
        }


class Rig:
    """World and session of one process."""

    def __init__(self, job: Job, cameras: Sequence[str]) -> None:
        self.job = job
        self.kinematics = Kinematics(job.robot)
        self.world = World(job.task.scene, job.robot, visuals=True)
        self._cameras = tuple(cameras)
        self._eye = Camera.recorded(self.world.model, self.world.scene.camera) if cameras else None
        supervisor = trial_supervisor(job.supervisor, self.world.dt, job.robot)
        rate_hz = job.teleop.rate_hz
        stack = ControlStack(
            self.world,
            self.kinematics,
            job.arbiter,
            rate_hz=rate_hz,
            supervisor=supervisor,
        )
        self.session = TeleopSession(stack, job.teleop, self._pictures)
        self._setup = LeaderSetup(job.robot, job.task, job.teleop, job.seed)

    def lead(self, trial: Trial, on_tick: Callable[[Tick], None]) -> SessionResult:
        """Run one episode."""
        teleop = self.job.teleop
        leader = LEADERS[teleop.leader].for_trial(self._setup, trial)
        stay = round(teleop.room_change_s * teleop.rate_hz)
        ticks = itertools.count(1)
        with closing(leader), ExitStack() as shown:
            # Leaving a room restores what was there when it was entered.
            self.world.mark_goal(*placement(trial.goal[self.job.task.carried]))
            shown.enter_context(self.room(trial))

            def tick(ticked: Tick) -> None:
                on_tick(ticked)
                if stay and (done := next(ticks)) % stay == 0:
                    shown.close()
                    shown.enter_context(self.room(trial, done // stay))

            return self.session.run(self.job.task, trial, leader, on_tick=tick)

    def room(self, trial: Trial, turn: int = 0) -> AbstractContextManager[None]:
        """Show one of the trial's rooms to the cameras."""
        job = self.job
        room = self.job.room(trial, turn)
        if room is None:
            return nullcontext()
        name, applied = room
        rng = stream(
            job.seed,
            f"room/{trial.purpose}/{name}" + (f"/{turn}" if turn else ""),
            trial.index,
        )
        return applied(self.world.model, job.task, trial, rng)

    def record(self, index: int) -> Attempt:
        """Return trial `index` as an interrupted recording left it, else run it.

        An episode's file gets its name after it was read back and the attempt's JSON file was written.
        """
        trial = self.job.trial(index)
        return self._adopted(trial) or self._recorded(trial)

    def _adopted(self, trial: Trial) -> Attempt | None:
        record = self._attempt_path(trial)
        if not record.exists():
            return None
        try:
            said = _Said.model_validate(durable.read_json(record))
        except (DataError, ValidationError):  # damaged since
            for path in (record, *self.job.folder.glob(f"*/episode_{trial.index:06d}.hdf5")):
                durable.set_aside(path, path.name)
            return None
        path = self.job.folder / said.path if said.path else None
        attempt = Attempt(trial, **said.model_dump(exclude={"path"}), path=path, adopted=True)
        if path is None:
            return attempt
        if path.exists():  # else killed before the file got its name
            judged = self._read_back(attempt, path)
            if judged.kept == attempt.kept:
                return judged
            durable.set_aside(path, path.name)  # damaged since
        return None

    def _recorded(self, trial: Trial) -> Attempt:
        job = self.job
        began = time.perf_counter()
        name = f"episode_{trial.index:06d}.hdf5"
        with EpisodeWriter(job.folder / REJECTED / name, self._meta(trial)) as writer:
            try:
                result = self.lead(trial, lambda tick: writer.append(**tick._asdict()))
            except (SimulationDivergedError, PlanningError) as error:
                return self._concluded(Attempt(trial, False, error.message.splitlines()[0]), began)
            said = {"completion_s": result.outcome.duration_s}
            said |= {
                name: value
                for name in MEASURES[1:]
                if np.isfinite(value := result.outcome.number(name))
            }
            attempt = Attempt(
                trial,
                result.success,
                self._reason(result),
                None,
                said,
                result.latencies_s,
            )
            empty = (
                len(result.q) < job.teleop.rate_hz or float(np.ptp(result.q, axis=0).max()) < 1e-3
            )
            if attempt.reason and empty:
                return self._concluded(attempt, began)
            partial = writer.finish(
                success=result.success,
                extra={"reason": attempt.reason, **said},
            )
            attempt = self._read_back(attempt, partial)
            path = job.folder / (KEPT if attempt.kept else REJECTED) / name
            attempt = self._concluded(replace(attempt, path=path), began)
            writer.publish(path)
            return attempt

    def _read_back(self, attempt: Attempt, path: Path) -> Attempt:
        camera = self.job.task.config.scene.camera
        size = (camera.height_px, camera.width_px)
        episode, found = inspect_episode(
            path,
            cameras=self.job.teleop.cameras,
            size=size,
            robot=self.job.robot,
        )
        faults = tuple(map(str, found))
        attempt = replace(attempt, faults=faults, reason=attempt.reason or next(iter(faults), ""))
        if episode is None:
            return attempt
        if (stamps := episode.image_timestamps) is not None:
            attempt = replace(
                attempt,
                sync_error_max_s=float(np.max(np.abs(stamps - episode.timestamps))),
            )
        if faults:
            return attempt
        return replace(
            attempt,
            quality=episode_quality(episode, self.kinematics),
            views=thumbnails(episode.images),
        )

    def _concluded(self, attempt: Attempt, began: float) -> Attempt:
        attempt = replace(attempt, wall_s=time.perf_counter() - began)
        record = {
            key: getattr(attempt, key)
            for key in ("success", "reason", "measures", "latencies_s", "wall_s")
        }
        record["path"] = attempt.path and f"{attempt.path.parent.name}/{attempt.path.name}"
        durable.make_folder(self.job.folder / ATTEMPTS)
        durable.write_text(self._attempt_path(attempt.trial), json.dumps(record) + "\n")
        return attempt

    def _attempt_path(self, trial: Trial) -> Path:
        return self.job.folder / ATTEMPTS / f"{trial.index:06d}.json"

    def _meta(self, trial: Trial) -> EpisodeMeta:
        teleop = self.job.teleop
        task = self.job.task
        extra = {
            "trial": trial.index,
            "purpose": trial.purpose,
            "leader": teleop.leader,
            "start_x_y_yaw": list(placement(trial.start[task.carried])),
            "goal_x_y_yaw": list(placement(trial.goal[task.carried])),
        }
        if (room := self.job.room(trial)) is not None:
            extra |= {"condition": room[0], "room_change_s": teleop.room_change_s}
        return EpisodeMeta(
            teleop.rate_hz,
            task.instruction,
            self.job.seed,
            teleop.cameras,
            extra=extra,
        )

    def _reason(self, result: SessionResult) -> str:
        if result.reason:
            return result.reason
        jerk = rms_jerk(result.q, self.job.teleop.rate_hz)
        limit = self.job.teleop.jerk_max_rad_s3
        return "" if jerk <= limit else f"RMS jerk {jerk:.0f} rad/s^3, limit {limit:.0f}"

    def close(self) -> None:
        """Free the renderer."""
        if self._eye is not None:
            self._eye.close()

    def _pictures(self) -> dict[str, Image]:
        if self._eye is None:
            return {}
        return {name: self._eye.picture(self.world.data, name).copy() for name in self._cameras}
