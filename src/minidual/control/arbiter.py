"""Arbitrate: the only writer of joint commands, with at most one driving source.

A switch or a silent source brakes timed commands along their paths; a halt drops them. States: docs/control.md.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from minidual.config.control import ArbiterConfig
from minidual.control.command_checks import check_openings
from minidual.control.commands import (
    HOLD,
    SOURCES,
    ArbiterState,
    Command,
    Reason,
    Refusal,
    RefusalLog,
)
from minidual.control.driving import Driving
from minidual.control.execution import Execution, Underway
from minidual.control.joint_target import JointTarget
from minidual.control.mailbox import Mailbox
from minidual.errors import UsageError, check_name
from minidual.robot.pair import Array, Robot

_DRIVING = (ArbiterState.WAITING, ArbiterState.ALIGNING, ArbiterState.ACTIVE, ArbiterState.STALE)


@dataclass(frozen=True)
class ArbiterOutput:
    """The arbiter's output of one tick.

    Attributes:
        q_target: (n,) [rad], finite and within limits.
        gripper: (2,), 0 closed to 1 open.
        active_source: Source whose command passed.
        switched_to: Mode confirmed now.
        executions: Running; their arms ignore `q_target`.
        halted: The arms must stop now.
        speed: Override of all motion, 0.1 to 1.
    """

    q_target: Array
    gripper: Array
    state: ArbiterState
    active_source: str | None
    switched_to: str | None
    refusals: tuple[Refusal, ...]
    executions: tuple[Execution, ...] = ()
    halted: bool = False
    speed: float = 1.0


@dataclass(frozen=True)
class _Switch:
    """A switch to a mode that waits for still arms since `since_s`."""

    mode: str
    since_s: float


@dataclass(frozen=True)
class _Halt:
    """A halt by a source, with hand openings (2,) or None."""

    source: str
    gripper: Array | None


class CommandArbiter:
    """Decides which joint target reaches the controllers.

    Streamed targets move at most `switch_step_max_rad` a tick.

    Args:
        gripper: Openings (2,) held until commanded otherwise.
        admit: Returns why the controllers refuse a command, or None.

    Attributes:
        speed: Share of full speed, from the next tick on.
        underway: Running timed commands.
        on_confirm: Called with the mode at confirmation, before the source's first command.
        on_flush: Called with the mode at a switch, "hold" at a halt.
    """

    def __init__(
        self,
        robot: Robot,
        config: ArbiterConfig | None = None,
        *,
        gripper: Array | None = None,
        control_dt_s: float = 0.001,
        admit: Callable[[Command], Reason | None] = lambda command: None,
    ) -> None:
        self.config = ArbiterConfig() if config is None else config
        self.underway = Underway(control_dt_s, robot, admit)
        self.on_confirm: Callable[[str], None] = lambda mode: None
        self.on_flush: list[Callable[[str], None]] = []
        self._refusals = RefusalLog()
        self._mailboxes = {
            source: Mailbox(robot, partial(self._refusals.note, source)) for source in SOURCES
        }
        self._requested: str | None = None
        self._halt: _Halt | None = None
        self._switch: _Switch | None = None
        self._robot = robot
        self._target: JointTarget | None = None  # from the first tick on
        openings = np.ones(2) if gripper is None else np.array(gripper, dtype=float)
        self._driving = Driving(self.config, self.underway, openings, self._refusals.note)
        self._last_tick_s: float | None = None
        self._affirmed: set[str] = set()
        self.speed = self.config.speed_override

    # Requests ------------------------------------------------------------------------------------------------

    def propose(self, source: str, command: Command) -> Refusal | None:
        """Offer a command; return its refusal, or None.

        The tick that takes it checks the posture. Commands of idle sources are kept until a flush.

        Raises:
            UsageError: Unknown source.
        """
        reason = self._mailbox(source).put(command)
        return None if reason is None else self._refusals.note(source, *reason)

    def affirm(self, source: str) -> None:
        """Report a source as alive; after silence for `stale_s` its timed commands brake."""
        if source not in self._affirmed:
            self._mailbox(source)
            self._affirmed.add(source)

    def request(self, mode: str) -> None:
        """Request a source, or "hold"; the last request counts.

        A repeated request by the active source does not cancel a pending hold.
        """
        check_name("mode", mode, (*SOURCES, HOLD))
        if self._requested == HOLD and mode == self.source:
            self._refusals.supersede(mode, f"'{HOLD}' was requested before the switch began")
            return
        if self._requested != mode:
            self._refusals.supersede(
                self._requested, f"'{mode}' was requested before the switch began"
            )
        self._requested = mode

    def halt(self, source: str, gripper: Array | None = None) -> None:
        """Stop the arms at the next tick; end driving and switching.

        Openings `gripper` (2,) are accepted only from the driving source.
        """
        self._mailbox(source)
        if gripper is not None:
            reason = check_openings(gripper)
            if reason:
                self._refusals.note(source, *reason)
                gripper = None
        if self._requested != HOLD:
            self._refusals.supersede(
                self._requested, "the arms were halted before the switch began"
            )
            self._requested = None
        openings = None if gripper is None else np.array(gripper, dtype=float)
        self._halt = _Halt(source, openings)

    def stand(self, q: Array, v: Array) -> None:
        """Forget the joint target: what drove the arms to q, v (n,) had none. They stop where they can."""
        if self._target is not None:
            self._target.stand(q, v)

    @property
    def source(self) -> str | None:
        """Source that may drive, or None."""
        return self._driving.source

    @property
    def state(self) -> ArbiterState:
        """What the arbiter does."""
        return self._driving.state

    @property
    def switching(self) -> bool:
        """Whether a switch is requested or waits."""
        return self._requested is not None or self._switch is not None

    # Tick ----------------------------------------------------------------------------------------------------

    def tick(self, now_s: float, q: Array, v: Array) -> ArbiterOutput:
        """Return the output at now_s [s] for measured, finite q (n,) [rad] and v (n,) [rad/s].

        A switch holds the arms, once they are at rest, at the measured posture.

        Raises:
            UsageError: Time runs backwards.
        """
        dt = self._elapsed(now_s)
        posture = np.clip(q, self._robot.q_lower, self._robot.q_upper)
        if self._target is None:
            self._target = JointTarget(self._robot, self.config)
            self._target.hold(posture)
        target = self._target
        driving = self._driving
        if self.source in self._affirmed:
            self._driving.alive_s = now_s
        self._affirmed.clear()
        halted = self._begin_halt(target, now_s, posture, v)
        was_braking = self.underway.braking
        ended = self._follow_underway(target)
        self._begin_requested(target, now_s, posture, v)
        switched_to = self._settle(target, now_s, posture, v)
        driven = False
        if driving.source is not None:
            if ended and not (was_braking and driving.is_gone(now_s)):
                driving.state = ArbiterState.WAITING
                driving.heard_s = now_s
            mailbox = self._mailboxes[driving.source]
            driven = driving.tick(mailbox, target, now_s, dt, self.speed, posture, v)
        for execution in self.underway.executions:
            execution.limit_speed(self.speed)
        return ArbiterOutput(
            target.q.copy(),
            driving.gripper.copy(),
            self.state,
            self.source if driven else None,
            switched_to,
            self._refusals.take(),
            self.underway.executions,
            halted,
            self.speed,
        )

    def _elapsed(self, now_s: float) -> float:
        last_s = now_s if self._last_tick_s is None else self._last_tick_s
        if not now_s >= last_s:
            raise UsageError(f"the arbiter's time runs backwards: {now_s} s after {last_s} s")
        self._last_tick_s = now_s
        return now_s - last_s

    def _follow_underway(self, target: JointTarget) -> bool:
        """Let the target follow running trajectories; return whether a timed command has ended."""
        if not self.underway.executions:
            return False
        for execution in self.underway.executions:
            if execution.why is not None:
                self._refusals.note(self.source or HOLD, *execution.why)
                execution.why = None
        target.q, ended = self.underway.follow(target.q)
        return ended

    # Switches and halts --------------------------------------------------------------------------------------

    def _begin_requested(self, target: JointTarget, now_s: float, q: Array, v: Array) -> None:
        mode = self._requested
        self._requested = None
        if mode is None:
            return
        if self._switch is not None:
            if mode == self._switch.mode:
                return
            self._refusals.supersede(self._switch.mode, f"'{mode}' was requested while settling")
        elif mode == self.source and self.state in _DRIVING:
            return
        self._driving.source = None
        self.underway.brake()
        target.stop(q, v)
        target.q, _ = self.underway.follow(target.q)
        self._flush(mode, now_s)
        self._switch = _Switch(mode, now_s)
        self._driving.state = ArbiterState.SETTLING

    def _settle(self, target: JointTarget, now_s: float, q: Array, v: Array) -> str | None:
        """End a switch whose arms are still, or have not become still in time; return the mode confirmed."""
        switch = self._switch
        if switch is None or not now_s > switch.since_s:
            return None
        speed = float(np.max(np.abs(v)))
        waited_s = now_s - switch.since_s
        still_speed = self.config.still_speed_rad_s
        if speed < still_speed and not self.underway.executions:
            self._switch = None
            target.hold(q)
            holds = switch.mode == HOLD
            self._driving.source = None if holds else switch.mode
            self._driving.state = ArbiterState.HOLDING if holds else ArbiterState.WAITING
            self._driving.heard_s = now_s
            self.on_confirm(switch.mode)
            return switch.mode
        if waited_s >= self.config.settle_timeout_s:
            self._switch = None
            self._driving.state = ArbiterState.STOPPED
            fastest = f"fastest joint {speed:.3f} rad/s after {waited_s:.3f} s"
            detail = f"{fastest}; still means below {still_speed} rad/s"
            self._refusals.note(switch.mode, "not_still", detail)
        return None

    def _begin_halt(self, target: JointTarget, now_s: float, q: Array, v: Array) -> bool:
        halt = self._halt
        self._halt = None
        if halt is None:
            return False
        if halt.gripper is not None and halt.source == self.source:
            self._driving.gripper = halt.gripper
        elif halt.gripper is not None:
            detail = "only the source that drives may move the hands"
            self._refusals.note(halt.source, "not_driving", detail)
        if self._switch is not None:
            self._refusals.supersede(self._switch.mode, "the arms were halted while settling")
            self._switch = None
        self.underway.executions = ()
        self._flush(HOLD, now_s)
        target.stop(q, v)
        self._driving.source = None
        self._driving.state = ArbiterState.STOPPED
        return True

    def _flush(self, mode: str, now_s: float) -> None:
        self._driving.flush()
        for mailbox in self._mailboxes.values():
            mailbox.flush(now_s)
        for listener in self.on_flush:
            listener(mode)

    def _mailbox(self, source: str) -> Mailbox:
        check_name("command source", source, SOURCES)
        return self._mailboxes[source]
