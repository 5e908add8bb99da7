"""Run and write one demonstration."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np

from minidual import durable
from minidual.collision.errors import PlanningError
from minidual.config.seeds import stream
from minidual.control.stack import ControlStack
from minidual.demos.attempt import ATTEMPTS, KEPT, REJECTED, Attempt, AttemptFiles
from minidual.demos.checks import thumbnails
from minidual.demos.corrections import DrivingPolicy
from minidual.demos.episode import inspect_episode
from minidual.demos.job import PURPOSE, Job, Room
from minidual.demos.lag import leader_lag
from minidual.demos.leader import LEADERS, Leader, LeaderSetup, follows_swiftly
from minidual.demos.link.linked_leader import LinkedLeader, linked
from minidual.demos.quality import episode_quality, rms_jerk
from minidual.demos.room_tour import RoomTour
from minidual.demos.schema import EpisodeMeta
from minidual.demos.session import SessionResult, TeleopSession, Tick
from minidual.demos.station import NO_STATION, Station
from minidual.demos.writer import EpisodeWriter
from minidual.errors import UsageError
from minidual.plant.render import Camera, StampedImage
from minidual.plant.world import SimulationDivergedError, World
from minidual.robot.kinematics import Kinematics
from minidual.skills.supervised import trial_supervisor
from minidual.tasks.judge import Outcome
from minidual.tasks.task import Trial, placement

__all__ = ["ATTEMPTS", "KEPT", "PURPOSE", "REJECTED", "Attempt", "Job", "Rig", "Room"]

MOTION_MIN_RAD = 1e-3
"""A failed episode in which no joint moves further, or under 1 s long, is not written."""


class Rig:
    """World and session of one process."""

    _leader: Leader | None = None

    def __init__(self, job: Job, cameras: Sequence[str]) -> None:
        self.job = job
        self.kinematics = Kinematics(job.robot)
        self.world = World(job.task.scene, job.robot, visuals=True)
        self._cameras = tuple(cameras)
        self._eye = Camera.recorded(self.world.model, self.world.scene.camera) if cameras else None
        stack = ControlStack(
            self.world,
            self.kinematics,
            job.arbiter,
            rate_hz=job.teleop.rate_hz,
            supervisor=trial_supervisor(job.supervisor, self.world.dt, job.robot),
        )
        if follows_swiftly(job.teleop):
            stack.anticipate(job.teleop.rate_hz)
        self.session = TeleopSession(stack, job.teleop, self._pictures)
        if job.policy is not None:
            self.session.policy = self._loaded(job.policy)
        self.station = NO_STATION

    def _loaded(self, load: Callable[[], DrivingPolicy]) -> DrivingPolicy:
        """Return the policy that is to be corrected; it must see what is recorded."""
        policy = load()
        missing = [camera for camera in policy.cameras if camera not in self._cameras]
        if missing:
            raise UsageError(
                f"the policy looks through camera '{missing[0]}'; recorded are "
                f"{', '.join(self._cameras) or 'none'}",
                remedy=f"--set 'teleop.cameras={list(policy.cameras)}'",
            )
        return policy

    @property
    def station(self) -> Station:
        """Where the person stands who leads; set it before the first trial."""
        return self.session.station

    @station.setter
    def station(self, station: Station) -> None:
        self.session.station = station

    def lead(self, trial: Trial, on_tick: Callable[[Tick], None]) -> SessionResult:
        """Run one episode; the leader stays connected until `close`."""
        task = self.job.task
        teleop = self.job.teleop
        leader = self._connected()
        ticks_per_room = round(teleop.room_change_s * teleop.rate_hz)
        # Leaving a room restores what was there when it was entered: the mark comes first.
        self.world.mark_goal(*placement(trial.goal[task.carried]))
        with RoomTour(lambda turn: self.room(trial, turn), ticks_per_room) as tour:

            def tick(measured: Tick) -> None:
                on_tick(measured)
                tour.tick()

            return self.session.run(task, trial, leader, on_tick=tick)

    def _connected(self) -> Leader:
        """Return the leader, connected at the first trial."""
        if self._leader is None:
            job = self.job
            setup = LeaderSetup(job.robot, job.task, job.teleop, job.seed, self.station)
            leader = LEADERS[job.teleop.leader].connect(setup)
            self._leader = linked(leader, setup)
        return self._leader

    def room(self, trial: Trial, turn: int = 0) -> AbstractContextManager[None]:
        """Show one of the trial's rooms to the cameras."""
        room = self.job.room(trial, turn)
        if room is None:
            return nullcontext()
        name, applied = room
        purpose = f"room/{trial.purpose}/{name}"
        if turn:
            purpose += f"/{turn}"
        rng = stream(self.job.seed, purpose, trial.index)
        return applied(self.world.model, self.job.task, trial, rng)

    def record(self, index: int) -> Attempt:
        """Return trial `index` as an interrupted recording left it, else run it.

        An episode's file gets its name after it was read back and the attempt's JSON file was
        written.
        """
        trial = self.job.trial(index)
        adopted = self._adopted(trial)
        if adopted is not None:
            return adopted
        return self._recorded(trial)

    def close(self) -> None:
        """Release the leader and free the renderer."""
        if self._leader is not None:
            self._leader.close()
            self._leader = None
        if self._eye is not None:
            self._eye.close()

    def _adopted(self, trial: Trial) -> Attempt | None:
        """Return the attempt of an interrupted recording if its files are whole."""
        attempt = AttemptFiles(self.job.folder).read(trial)
        if attempt is None or attempt.path is None:
            return attempt
        if not attempt.path.exists():  # killed before the file got its name
            return None
        judged = self._read_back(attempt, attempt.path)
        if judged.kept != attempt.kept:  # the file was damaged since
            durable.set_aside(attempt.path, attempt.path.name)
            return None
        return judged

    def _recorded(self, trial: Trial) -> Attempt:
        """Run a trial, again and again while who leads throws the episode away."""
        attempt = None
        while attempt is None:
            attempt = self._recorded_once(trial)
        return attempt

    def _recorded_once(self, trial: Trial) -> Attempt | None:
        """Return the attempt, None if it was thrown away."""
        began = time.perf_counter()
        folder = self.job.folder
        name = AttemptFiles.episode_name(trial.index)
        with EpisodeWriter(folder / REJECTED / name, self._meta(trial)) as writer:
            try:
                result = self.lead(trial, lambda tick: writer.append(**tick.values()))
            except (SimulationDivergedError, PlanningError) as error:
                reason = error.message.splitlines()[0]
                return self._concluded(Attempt(trial, success=False, reason=reason), began)
            if result.ended_by == "discard":
                return None
            attempt = Attempt(
                trial,
                success=result.success,
                reason=self._reason(result),
                measures={**_measures(result.outcome), **self._link_measures()},
                latencies_s=result.latencies_s,
            )
            is_unwanted = result.ended_by == "next" or self._is_empty(result)
            if attempt.reason and is_unwanted:
                return self._concluded(attempt, began)
            partial = writer.finish(
                success=result.success,
                extra={"reason": attempt.reason, **attempt.measures, **self._leader_facts()},
            )
            attempt = self._read_back(attempt, partial)
            path = folder / (KEPT if attempt.kept else REJECTED) / name
            attempt = self._concluded(replace(attempt, path=path), began)
            writer.publish(path)
            return attempt

    def _leader_facts(self) -> Mapping[str, object]:
        leader = self._leader
        return {} if leader is None else leader.facts

    def _link_measures(self) -> dict[str, float]:
        """Return what the link did in the episode; {} without one."""
        leader = self._leader
        return leader.measures() if isinstance(leader, LinkedLeader) else {}

    def _write_link(self, trial: Trial) -> None:
        leader = self._leader
        if isinstance(leader, LinkedLeader) and leader.ticks:
            path = AttemptFiles(self.job.folder).link_path(trial.index)
            durable.make_folder(path.parent)
            durable.write_csv(path, leader.rows())

    def _is_empty(self, result: SessionResult) -> bool:
        """Return whether an episode lasts under a second, or no joint moves."""
        if len(result.q) < self.job.teleop.rate_hz:
            return True
        return float(np.ptp(result.q, axis=0).max()) < MOTION_MIN_RAD

    def _reason(self, result: SessionResult) -> str:
        """Return why an episode is no demonstration, or ""."""
        if result.reason:
            return result.reason
        jerk = rms_jerk(result.q, self.job.teleop.rate_hz)
        limit = self.job.teleop.jerk_max_rad_s3
        if jerk <= limit:
            return ""
        return f"RMS jerk {jerk:.0f} rad/s^3, limit {limit:.0f}"

    def _read_back(self, attempt: Attempt, path: Path) -> Attempt:
        """Return the attempt with what its file says."""
        camera = self.job.task.config.scene.camera
        episode, faults = inspect_episode(
            path,
            cameras=self.job.teleop.cameras,
            size=(camera.height_px, camera.width_px),
            robot=self.job.robot,
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
            quality=episode_quality(episode, self.kinematics),
            views=thumbnails(episode.images),
        )

    def _concluded(self, attempt: Attempt, began: float) -> Attempt:
        """Return the attempt with its wall time, and write its JSON file."""
        attempt = replace(attempt, wall_s=time.perf_counter() - began)
        self._write_link(attempt.trial)
        AttemptFiles(self.job.folder).write(attempt)
        return attempt

    def _meta(self, trial: Trial) -> EpisodeMeta:
        teleop = self.job.teleop
        task = self.job.task
        extra: dict[str, object] = {
            "trial": trial.index,
            "purpose": trial.purpose,
            "leader": teleop.leader,
            "start_x_y_yaw": list(placement(trial.start[task.carried])),
            "goal_x_y_yaw": list(placement(trial.goal[task.carried])),
        }
        if teleop.correct:
            extra["corrects"] = Path(teleop.correct).name
        room = self.job.room(trial)
        if teleop.link.network:
            extra["network"] = teleop.link.network
        if room is not None:
            extra["condition"] = room[0]
            extra["room_change_s"] = teleop.room_change_s
        return EpisodeMeta(
            fps=teleop.rate_hz,
            task=task.instruction,
            seed=self.job.seed,
            cameras=teleop.cameras,
            extra=extra,
        )

    def _pictures(self) -> dict[str, StampedImage]:
        if self._eye is None:
            return {}
        return {name: self._eye.stamped(self.world.data, name) for name in self._cameras}


def _measures(outcome: Outcome) -> dict[str, float]:
    """Return the outcome's finite measures."""
    measures = {"completion_s": outcome.duration_s}
    for name in ("goal_error_m", "tilt_max_rad"):
        value = outcome.number(name)
        if np.isfinite(value):
            measures[name] = value
    return measures
