"""The world and the session in which one process runs its demonstrations."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext

from minidual.config.seeds import stream
from minidual.control.stack import ControlStack
from minidual.demos.attempt import ATTEMPTS, KEPT, REJECTED, Attempt
from minidual.demos.corrections import DrivingPolicy
from minidual.demos.episode_recorder import EpisodeRecorder
from minidual.demos.job import PURPOSE, Job, Room
from minidual.demos.leader import LEADERS, Leader, LeaderSetup, follows_swiftly
from minidual.demos.link.linked_leader import linked
from minidual.demos.room_tour import RoomTour
from minidual.demos.session import SessionResult, TeleopSession, Tick
from minidual.demos.station import NO_STATION, Station
from minidual.errors import UsageError
from minidual.plant.render import Camera, StampedImage
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.skills.supervised import trial_supervisor
from minidual.tasks.task import Trial, placement

__all__ = ["ATTEMPTS", "KEPT", "PURPOSE", "REJECTED", "Attempt", "Job", "Rig", "Room"]


class Rig:
    """World and session of one process.

    Attributes:
        leader: Who leads, None before the first trial and after `close`.
        last: What became of the trial before, for the station.
    """

    leader: Leader | None = None
    last: str = ""

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
        """Return the policy to be corrected; its cameras must be recorded."""
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
        """Station of the person who leads; set it before the first trial."""
        return self.session.station

    @station.setter
    def station(self, station: Station) -> None:
        self.session.station = station

    def lead(self, trial: Trial, on_tick: Callable[[Tick], None]) -> SessionResult:
        """Run one episode; the leader stays connected until `close`."""
        task = self.job.task
        teleop = self.job.teleop
        leader = self._connected()
        self.session.last = self.last
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
        if self.leader is None:
            job = self.job
            setup = LeaderSetup(job.robot, job.task, job.teleop, job.seed, self.station)
            leader = LEADERS[job.teleop.leader].connect(setup)
            self.leader = linked(leader, setup)
        return self.leader

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
        """Return trial `index` as an interrupted recording left it, else run it."""
        trial = self.job.trial(index)
        recorder = EpisodeRecorder(self.job, self.kinematics)
        adopted = recorder.adopted(trial)
        if adopted is not None:
            return adopted
        attempt = recorder.record(trial, self)
        became = f"rejected: {attempt.reason}" if attempt.reason else "kept"
        self.last = f"trial {index} was {became}"
        return attempt

    def close(self) -> None:
        """Release the leader and free the renderer."""
        if self.leader is not None:
            self.leader.close()
            self.leader = None
        if self._eye is not None:
            self._eye.close()

    def _pictures(self) -> dict[str, StampedImage]:
        if self._eye is None:
            return {}
        return {name: self._eye.stamped(self.world.data, name) for name in self._cameras}
