"""One teleoperated episode; ticks follow simulated time."""

import contextlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from minidual import emergency
from minidual.config.learning import TeleopConfig
from minidual.config.scene import SceneConfig
from minidual.control.commands import HOLD, ArbiterState, JointCommand, Refusal
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.demos.corrections import Corrections, DrivingPolicy
from minidual.demos.leader import Feedback, Leader
from minidual.demos.mirror import Mirror
from minidual.demos.seat import Seat, for_a_person
from minidual.demos.sensed import SensedInputs
from minidual.demos.signals import Driver, Signals, recorded_signals
from minidual.demos.station import NO_STATION, Button
from minidual.errors import MinidualError
from minidual.plant.protocol import Plant, openings_of
from minidual.plant.render import Image, StampedImage
from minidual.robot.pair import Array
from minidual.tasks.judge import Judge, Outcome, Resettable, begin
from minidual.tasks.task import Task, Trial

SOURCE = "teleop"
EndedBy = Literal["leader", "failure", "discard", "next", "time_limit", "stopped", "reflex"]
_ENDS: dict[Button, EndedBy] = {
    Button.SUCCESS: "leader",
    Button.FAILURE: "failure",
    Button.DISCARD: "discard",
    Button.NEXT: "next",
}


class SimulatedPlant(Plant, Resettable, Protocol):
    """A plant with known truth, which a session resets to each start.

    Attributes:
        scene: As configured.
        observer: Called while time stands still, or None.
    """

    scene: SceneConfig
    observer: Callable[[Any], None] | None

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        ...


class HandoverError(MinidualError):
    """The arbiter did not accept the leader."""


class Tick(NamedTuple):
    """Measurements of one tick, and the command that followed.

    Names and shapes are those of the schema.

    Attributes:
        image_timestamps: Stamp of the picture that is furthest from the joints in time; None
            without pictures.
        effort: Motor torques [Nm], None where they are not measured.
        signals: What `teleop.signals` chooses, by name.
    """

    timestamps: float
    image_timestamps: float | None
    qpos: Array
    qvel: Array
    gripper: Array
    images: dict[str, Image]
    action: Array
    action_gripper: Array
    effort: Array | None = None
    signals: Mapping[str, Array] = MappingProxyType({})

    def values(self) -> dict[str, Any]:
        """Return the fields of the schema by name, and the images."""
        values = self._asdict()
        values |= values.pop("signals")
        return values


def _furthest_stamp(pictures: Mapping[str, StampedImage], joints_stamp_s: float) -> float | None:
    """Return the stamp furthest from that of the joints [s], or None without pictures."""
    stamps_s = [picture.stamp_s for picture in pictures.values()]
    return max(stamps_s, key=lambda stamp_s: abs(stamp_s - joints_stamp_s), default=None)


@dataclass
class SessionResult:
    """One episode.

    Attributes:
        q: (T, n) measured joints [rad]; images go to `on_tick` only.
        latencies_s: Wall time per tick from reading the leader to the end of the first physics
            step.
        ended_by: "stopped": no readings came; else the button that ended it, "leader" for success.
        held: Why the arms did not follow the leader at the end, or "".
    """

    q: Array
    outcome: Outcome
    latencies_s: list[float]
    refusals: list[Refusal] = field(default_factory=list)
    ended_by: EndedBy = "leader"
    reflex: str = ""
    held: str = ""

    @property
    def success(self) -> bool:
        """Whether the task was achieved and the leader ended the episode."""
        return self.outcome.success and self.ended_by == "leader"

    @property
    def reason(self) -> str:
        """Why the episode is no demonstration, or ""."""
        if self.reflex:
            return self.reflex
        if self.ended_by == "stopped" and not self.refusals:
            return "the leader fell silent"
        if self.ended_by == "failure":
            return f"called a failure by who led it; {self.outcome.reason or 'no test failed'}"
        if self.ended_by in ("discard", "next"):
            return "thrown away by who led it"
        if self.refusals:
            refusal = self.refusals[0]
            return f"the arbiter refused {refusal.name}: {refusal.detail}"
        if self.success:
            return ""
        if self.held:
            return f"the arms held: {self.held}"
        return self.outcome.reason or "the leader did not end the episode in time"


class _TickRun(NamedTuple):
    """One tick that was run.

    Attributes:
        tick: None at the end of the episode: nothing was commanded.
        ended_by: What ended the episode, or None.
    """

    tick: Tick | None
    latency_s: float
    ended_by: EndedBy | None


@dataclass
class _Drive:
    """Result of driving the arms; see `SessionResult`."""

    q: list[Array] = field(default_factory=list)
    latencies_s: list[float] = field(default_factory=list)
    ended_by: EndedBy = "time_limit"


class TeleopSession:
    """Runs episodes in the stack's world, at its rate; a reflex ends the episode.

    `pictures` returns the stamped images by camera, as recorded.

    Attributes:
        station: Where the person stands who leads.
        policy: Drives until the leader takes over; None: the leader drives.
        last: What became of the episode before, for the station.
    """

    def __init__(
        self,
        stack: ControlStack[SimulatedPlant],
        config: TeleopConfig,
        pictures: Callable[[], dict[str, StampedImage]] = dict,
    ) -> None:
        self.stack = stack
        self.world = stack.plant
        self.config = config
        self.station = NO_STATION
        self.last = ""
        self.policy: DrivingPolicy | None = None
        self._pictures = pictures
        self._signals = Signals(stack, recorded_signals(config))
        self._corrections: Corrections | None = None
        self._sensed = SensedInputs(stack, {})

    def run(
        self,
        task: Task,
        trial: Trial,
        leader: Leader,
        *,
        on_tick: Callable[[Tick], None] = lambda tick: None,
    ) -> SessionResult:
        """Run one episode; `on_tick` is called after each command.

        Raises:
            UsageError: Leader and follower are apart, or have other joints; the policy reads what
                is not sensed here.
            HandoverError: The arbiter refused.
            Exception: What failed in a leader, a camera or `on_tick`, once the arms have stopped.
        """
        if leader.features.realtime:
            task = for_a_person(task, self.config.person.time_limit_s)
        judge = begin(self.world, task, trial)
        self.stack.reset()
        leader.align(trial, self.world.q)
        mirror = Mirror(leader, self.world.robot, self.config)
        mirror.begin(self.world.q)
        seat = Seat(mirror, self.station, self.config, self._freeze)
        seat.last = self.last
        self._signals.reset()
        self._corrections = None
        if self.policy is not None:
            self._sensed = SensedInputs(self.stack, self.policy.inputs)
            self._corrections = Corrections(self.policy, mirror)
            self._corrections.begin(self.world.q, openings_of(self.world))
        button = seat.begin()
        if button is not None:
            return self._not_begun(judge, _ENDS[button])
        try:
            return self._run(judge, seat, on_tick)
        except Exception as error:
            with contextlib.suppress(ReflexError):
                self.stack.fail(error)
                self.stack.advance()
            while self.stack.stopping:
                self.stack.advance()
            raise

    def _freeze(self) -> None:
        """Show the world while its time stands still."""
        emergency.check()
        if self.world.observer is not None:
            self.world.observer(self.world)

    def _not_begun(self, judge: Judge, ended_by: EndedBy) -> SessionResult:
        q = np.empty((0, self.world.robot.dof))
        return SessionResult(q, judge.outcome(self.world), [], ended_by=ended_by)

    def _run(
        self,
        judge: Judge,
        seat: Seat,
        on_tick: Callable[[Tick], None],
    ) -> SessionResult:
        self._hand_over(judge)
        drive = self._drive(judge, seat, on_tick)
        self._come_to_rest(judge)
        reflex = self.stack.reflex
        return SessionResult(
            q=np.array(drive.q).reshape(-1, self.world.robot.dof),
            outcome=judge.outcome(self.world),
            latencies_s=drive.latencies_s,
            refusals=self.stack.refusals,
            ended_by=drive.ended_by if reflex is None else "reflex",
            reflex="" if reflex is None else reflex.message,
            held=seat.mirror.gate.held,
        )

    def _hand_over(self, judge: Judge) -> None:
        """Run until the arbiter forwards the leader."""
        self.stack.request(SOURCE)
        output = self.stack.arbitrate()
        while output.switched_to != SOURCE:
            self._move(judge, self.stack.every)
            reflex = self.stack.reflex
            if reflex is not None:
                raise HandoverError(f"the arbiter did not hand over: {reflex.message}")
            if output.state == ArbiterState.STOPPED:
                reason = output.refusals[-1].detail
                raise HandoverError(f"the arbiter did not hand over: {reason}")
            output = self.stack.arbitrate()

    def _drive(self, judge: Judge, seat: Seat, on_tick: Callable[[Tick], None]) -> _Drive:
        """Let the leader drive until the episode ends."""
        drive = _Drive()
        seat.start_clock()
        for k in range(self._ticks_max(seat.mirror.leader)):
            button = seat.wait_for_tick(k)
            if button is not None:
                drive.ended_by = _ENDS[button]
                break
            run = self._tick(k, judge, seat)
            if run.tick is not None:
                drive.latencies_s.append(run.latency_s)
                drive.q.append(run.tick.qpos)
                on_tick(run.tick)
            if run.ended_by is not None:
                drive.ended_by = run.ended_by
                break
            self._move(judge, self.stack.every - 1)
            if self.stack.reflex is not None:
                break
        return drive

    def _ticks_max(self, leader: Leader) -> int:
        if leader.features.realtime:
            limit_s = self.config.person.time_limit_s
        else:
            limit_s = self.world.scene.task.time_limit_s
        return round(limit_s * self.config.rate_hz)

    def _tick(self, k: int, judge: Judge, seat: Seat) -> _TickRun:
        """Measure, read the leader, command, and run the first physics step."""
        world = self.world
        stamp_s = world.stamp_s
        q = world.q
        v = world.v
        gripper = openings_of(world)
        effort = world.tau.copy()
        pictures = self._pictures()
        started = time.perf_counter()
        images = {name: picture.image for name, picture in pictures.items()}
        corrections = self._corrections
        if corrections is None:
            driver = Driver.LEADER
            wanted = seat.read(k)
        else:
            reading = seat.read(k, moves=corrections.drives)
            state = np.concatenate([q, gripper, self._sensed.read()])
            wanted = None
            if seat.ending is None:
                wanted = corrections.command(reading, seat.pressed, images, state)
            driver = corrections.driver
        if seat.ending is not None:
            return _TickRun(None, 0.0, _ENDS[seat.ending])
        if wanted is not None:
            command = JointCommand(wanted.target, wanted.openings, stamp_s, k)
            self.stack.propose(SOURCE, command)
        signals = self._signals.measure(pictures, driver, seat.late_s)
        output = self.stack.arbitrate()
        tick = Tick(
            timestamps=stamp_s,
            image_timestamps=_furthest_stamp(pictures, stamp_s),
            qpos=q,
            qvel=v,
            gripper=gripper,
            images=images,
            action=output.q_target,
            action_gripper=output.gripper,
            effort=effort,
            signals=signals,
        )
        self._move(judge, 1)
        latency_s = time.perf_counter() - started
        self._feed_back(seat.mirror.leader, stamp_s, q, gripper)
        stopped = output.state == ArbiterState.STOPPED
        return _TickRun(tick, latency_s, "stopped" if stopped else None)

    def _feed_back(self, leader: Leader, stamp_s: float, q: Array, gripper: Array) -> None:
        """Pass the arms' forces to the leader, and the leader's faults to the supervisor."""
        supervisor = self.stack.supervisor
        met_nm = supervisor.observer.external.copy()
        leader.feedback(Feedback(stamp_s, q, gripper, supervisor.touch, met_nm))
        if leader.violation is not None:
            supervisor.report(leader.violation)

    def _come_to_rest(self, judge: Judge) -> None:
        if self.stack.source is not None:
            self.stack.request(HOLD)  # a leader whose episode has ended must not drive on
        while self.stack.stopping or self.stack.arbiter.switching:
            with contextlib.suppress(ReflexError):
                self.stack.step()
            judge.observe(self.world)

    def _move(self, judge: Judge, steps: int) -> None:
        """Run physics steps, none after a reflex."""
        for _ in range(steps):
            if self.stack.reflex is None:
                with contextlib.suppress(ReflexError):
                    self.stack.advance()
                judge.observe(self.world)
