"""The command arbiter: the only writer of joint commands, with at most one driving source.

A switch or a silent source brakes timed commands along their paths; a halt drops them. States: docs/control.md.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from minidual.config.control import ArbiterConfig
from minidual.control.commands import (
    HOLD,
    SOURCES,
    ArbiterState,
    Command,
    JointCommand,
    Reason,
    Refusal,
)
from minidual.control.execution import Execution, Underway
from minidual.control.mailbox import Mailbox, check_openings
from minidual.errors import UsageError, check_name
from minidual.robot.pair import SIDES, Array, Robot

_STOP_SHARE = 0.5
"""Share of the joints' acceleration limits for stopping at a switch."""
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


class CommandArbiter:
    """Decides which joint target reaches the controllers.

    Streamed targets move at most `switch_step_max_rad` a tick.

    Args:
        gripper: Openings (2,) held until commanded otherwise.
        admit: Returns why the controllers refuse a command, or None.
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
        self._robot = robot
        self.underway = Underway(control_dt_s, robot, admit)
        self.on_confirm: Callable[[str], None] = lambda mode: None
        """Called with the mode at confirmation, before the source's first command."""
        self.on_flush: list[Callable[[str], None]] = []
        """Called with the mode at a switch, "hold" at a halt."""
        self._mailboxes = {
            source: Mailbox(robot, partial(self._refuse, source)) for source in SOURCES
        }
        self._requested: str | None = None
        self._halt: tuple[str, Array | None] | None = None
        self._refusals: list[Refusal] = []
        self.state = ArbiterState.HOLDING
        self.source: str | None = None
        """Source that may drive."""
        self._switch: tuple[str, float] | None = None
        """Mode to switch to, and since when [s]."""
        self._target: Any = None
        """(n,) [rad], from the first tick on."""
        self._was = robot.home
        self._gripper = np.ones(2) if gripper is None else np.array(gripper, dtype=float)
        self._last_tick_s: float | None = None
        self._heard_s = 0.0
        self._affirmed: set[str] = set()
        self._streamed = set[int]()
        self._stopping = set[int]()
        """Arms with a fresh streamed command, and arms on the way to where they can stop since theirs have ended."""
        self._alive_s = -np.inf
        self.speed = self.config.speed_override
        """Share of full speed, from the next tick on."""

    def propose(self, source: str, command: Command) -> Refusal | None:
        """Offer a command; return its refusal, or None.

        A tick that takes it checks the posture. Commands of idle sources are kept until a flush.

        Raises:
            UsageError: Unknown source.
        """
        reason = self._mailbox(source).put(command)
        return None if reason is None else self._refuse(source, *reason)

    def affirm(self, source: str) -> None:
        """Report a source as alive; after silence for `stale_s` its timed commands brake."""
        if source not in self._affirmed:
            self._mailbox(source)
            self._affirmed.add(source)

    def request(self, mode: str) -> None:
        """Request a source, or "hold"; the last request counts, but one of who drives takes back no hold."""
        check_name("mode", mode, (*SOURCES, HOLD))
        if self._requested == HOLD and mode == self.source:
            self._requested = mode
            mode = HOLD
        if self._requested not in (None, mode):
            self._refuse(
                self._requested,
                "superseded",
                f"'{mode}' was requested before the switch began",
            )
        self._requested = mode

    def halt(self, source: str, gripper: Array | None = None) -> None:
        """Stop the arms at the next tick; end driving and switching.

        Openings `gripper` (2,) are accepted only from the driving source.
        """
        self._mailbox(source)
        if gripper is not None and (reason := check_openings(gripper)):
            self._refuse(source, *reason)
            gripper = None
        if self._requested not in (None, HOLD):
            self._refuse(
                self._requested,
                "superseded",
                "the arms were halted before the switch began",
            )
            self._requested = None
        self._halt = (source, None if gripper is None else np.array(gripper, dtype=float))

    def _mailbox(self, source: str) -> Mailbox:
        check_name("command source", source, SOURCES)
        return self._mailboxes[source]

    @property
    def switching(self) -> bool:
        """Whether a switch is requested or waits."""
        return self._requested is not None or self._switch is not None

    def tick(
        self,
        now_s: float,
        q_measured: Array,
        v_measured: Array,
        q_held: Array | None = None,
    ) -> ArbiterOutput:
        """Return the output at now_s [s] for measured q (n,) [rad] and v (n,) [rad/s].

        A switch holds arms at rest at `q_held` (n,), by default at the measured posture.

        Raises:
            UsageError: Time runs backwards, or the first posture is not finite.
        """
        dt = self._elapsed(now_s)
        posture = self._posture(q_measured)
        moved = (
            0.25 * (posture - self._was) / dt if dt > 0.0 else v_measured
        )  # velocities may be what has failed
        speed = float(np.max(np.abs([v_measured, moved])))  # NaN counts as not still
        self._was = posture
        if self.source in self._affirmed:
            self._alive_s = now_s
        self._affirmed.clear()
        halted = self._begin_halt(now_s, posture, v_measured)
        ended = False
        cut = self.underway.braking
        if self.underway.executions:
            for execution in self.underway.executions:
                if execution.why is not None:
                    self._refuse(self.source or HOLD, *execution.why)
                    execution.why = None
            self._target, ended = self.underway.follow(self._target)
        held = posture if q_held is None else self._posture(q_held)
        self._begin_requested(now_s, held, v_measured)
        switched_to = None
        if self._switch is not None and now_s > self._switch[1]:
            switched_to = self._settle(*self._switch, now_s, speed, held)
        driven = False
        if self.source is not None:
            if ended and not (cut and self._is_gone(now_s)):
                self.state = ArbiterState.WAITING
                self._heard_s = now_s
            self._begin_timed(self.source, now_s, posture, v_measured)
            heard = self._streamed
            driven = self._drive(self.source, now_s, dt)
            if (silent := heard - self._streamed) or self._stopping:
                self._stop_silent(silent, self._where_they_stop(posture, v_measured))
        for execution in self.underway.executions:
            execution.limit_speed(self.speed)
        refusals = tuple(self._refusals)
        self._refusals = []
        now = self._target.copy(), self._gripper.copy(), self.state, self.source if driven else None
        return ArbiterOutput(
            *now,
            switched_to,
            refusals,
            self.underway.executions,
            halted,
            self.speed,
        )

    def _stop_silent(self, silent: set[int], rest: Array) -> None:
        """Hold arms where they can stop: at once if nobody drives, else in bounded steps, arm by arm."""
        driven = self.state in (ArbiterState.ACTIVE, ArbiterState.ALIGNING)
        bound = self.config.switch_step_max_rad
        way = rest - self._target
        self._target = self._target.copy()
        arms = {
            arm
            for arm in range(len(SIDES))
            if arm not in self._streamed and not self.underway.busy((arm,))
        }
        arms &= (self._stopping | silent) if driven else arms
        # Nearer arms stay at their target: loaded ones would sag.
        far = {arm for arm in arms if np.abs(way[self._robot.joints_of(arm)]).max() > bound}
        for arm in (
            (far | arms & self._stopping) if driven else (arms & (silent | far) if far else ())
        ):
            if driven and arm in silent:
                self._refuse(
                    self.source or HOLD,
                    "stale",
                    f"{SIDES[arm]} arm: no command for {self.config.stale_s} s",
                )
            joints = self._robot.joints_of(arm)
            self._target[joints] += np.clip(way[joints], -bound, bound) if driven else way[joints]
        self._stopping = far if driven else set()

    def stand(self, q: Array, v: Array | float = 0.0) -> None:
        """Forget the joint target: what drove the arms to q, v (n,) had none. They stop where they can; NaN is rest."""
        v = np.clip(np.nan_to_num(v), -self._robot.v_max, self._robot.v_max)
        rest = q + v * np.abs(v) / (2.0 * _STOP_SHARE * self._robot.a_max)
        self._target = np.clip(rest, self._robot.q_lower, self._robot.q_upper)

    def _elapsed(self, now_s: float) -> float:
        last = now_s if self._last_tick_s is None else self._last_tick_s
        if not now_s >= last:
            raise UsageError(f"the arbiter's time runs backwards: {now_s} s after {last} s")
        self._last_tick_s = now_s
        return now_s - last

    def _posture(self, q_measured: Array) -> Array:
        usable = np.shape(q_measured) == (self._robot.dof,) and bool(np.isfinite(q_measured).all())
        if usable:
            posture = np.clip(q_measured, self._robot.q_lower, self._robot.q_upper)
            if self._target is None:
                self._target = posture
            return posture
        if self._target is None:
            raise UsageError(
                f"the first measured posture is not {self._robot.dof} finite angles: {q_measured}",
            )
        self._refuse("measurement", "not_finite", f"measured joints {q_measured}")
        return self._target

    def _begin_requested(self, now_s: float, posture: Array, v_measured: Array) -> None:
        mode = self._requested
        self._requested = None
        if mode is None:
            return
        if self._switch is not None:
            if mode == self._switch[0]:
                return
            self._refuse(self._switch[0], "superseded", f"'{mode}' was requested while settling")
        elif mode == self.source and self.state in _DRIVING:
            return
        self.source = None
        self.underway.brake()
        self._target, _ = self.underway.follow(self._where_they_stop(posture, v_measured))
        self._flush(mode, now_s)
        self._switch = mode, now_s
        self.state = ArbiterState.SETTLING

    def _begin_halt(self, now_s: float, posture: Array, v_measured: Array) -> bool:
        if self._halt is None:
            return False
        (source, gripper) = self._halt
        self._halt = None
        if gripper is not None and source == self.source:
            self._gripper = gripper
        elif gripper is not None:
            self._refuse(source, "not_driving", "only the source that drives may move the hands")
        if self._switch is not None:
            self._refuse(self._switch[0], "superseded", "the arms were halted while settling")
            self._switch = None
        self.underway.executions = ()
        self._flush(HOLD, now_s)
        self._target = self._where_they_stop(posture, v_measured)
        self.source = None
        self.state = ArbiterState.STOPPED
        return True

    def _flush(self, mode: str, now_s: float) -> None:
        self._streamed = set()
        self._stopping = set()
        for mailbox in self._mailboxes.values():
            mailbox.flush(now_s)
        for listener in self.on_flush:
            listener(mode)

    def _settle(
        self,
        mode: str,
        since_s: float,
        now_s: float,
        speed: float,
        posture: Array,
    ) -> str | None:
        waited = now_s - since_s
        still_speed = self.config.still_speed_rad_s
        if speed < still_speed and not self.underway.executions:
            self._switch = None
            self._target = posture
            self.source = None if mode == HOLD else mode
            self.state = ArbiterState.HOLDING if mode == HOLD else ArbiterState.WAITING
            self._heard_s = now_s
            self.on_confirm(mode)
            return mode
        if waited >= self.config.settle_timeout_s:
            self._switch = None
            self.state = ArbiterState.STOPPED
            fastest = f"fastest joint {speed:.3f} rad/s after {waited:.3f} s"
            self._refuse(mode, "not_still", f"{fastest}; still means below {still_speed} rad/s")
        return None

    def _refuse(self, source: str, name: str, detail: str) -> Refusal:
        self._refusals.append(Refusal(source, name, detail))
        return self._refusals[-1]

    def _begin_timed(self, source: str, now_s: float, posture: Array, v: Array) -> None:
        for command in self._mailboxes[source].take_timed(now_s, self.config.stale_s):
            if reason := self.underway.begin(
                command,
                posture,
                v,
                self.config.switch_step_max_rad,
                self._gripper,
            ):
                self._refuse(source, *reason)
                continue
            self._alive_s = max(self._alive_s, min(now_s, command.stamp_s))
            for arm in command.arms:
                self._gripper[arm] = command.gripper[arm]

    def _fresh(self, source: str, now_s: float) -> dict[int, JointCommand]:
        mailbox = self._mailboxes[source]
        fresh = mailbox.fresh(now_s, self.config.stale_s)
        for arm, command in list(fresh.items()):
            reason = self.underway.busy((arm,)) or self.underway.admit(command)
            if reason is not None:
                self._refuse(source, *reason)
                mailbox.drop(arm)
                del fresh[arm]
        return fresh

    def _drive(self, source: str, now_s: float, dt: float) -> bool:
        fresh = self._fresh(source, now_s)
        was_aligning = self.state == ArbiterState.ALIGNING
        self._streamed = set(fresh)
        if fresh:
            newest_s = max(c.stamp_s for c in fresh.values())
            self._heard_s = max(self._heard_s, newest_s)
            self._alive_s = max(self._alive_s, min(now_s, newest_s))
        driven = self._run_timed(now_s)
        if not fresh:
            if not driven:
                self._go_quiet(now_s)
            return driven
        wanted = self._target.copy()
        for arm, command in fresh.items():
            joints = self._robot.joints_of(arm)
            lower = self._robot.q_lower[joints]
            upper = self._robot.q_upper[joints]
            wanted[joints] = np.clip(
                command.q[joints] if len(command.arms) > 1 else command.q,
                lower,
                upper,
            )
        step = wanted - self._target
        largest = float(np.max(np.abs(step)))
        # A step over the bound starts an alignment, which ends once one tick at its speed reaches the target.
        align = self.speed * self.config.align_speed_rad_s * dt
        aligning = largest > self.config.switch_step_max_rad or (was_aligning and largest > align)
        if aligning:
            wanted = self._target + step * min(
                1.0,
                min(align, self.config.switch_step_max_rad) / largest,
            )
        else:
            # The hands do not move while aligning, so that they keep what they hold.
            for arm, command in fresh.items():
                self._gripper[arm] = command.gripper[arm]
        self._target = wanted
        self.state = ArbiterState.ALIGNING if aligning else ArbiterState.ACTIVE
        return True

    def _run_timed(self, now_s: float) -> bool:
        if not self.underway.executions:
            return False
        if self._is_gone(now_s):
            self.underway.brake()
        if self.underway.braking:
            self.state = ArbiterState.STALE
            return False
        self._heard_s = now_s
        self.state = ArbiterState.ACTIVE
        return True

    def _is_gone(self, now_s: float) -> bool:
        return now_s - self._alive_s > self.config.stale_s + 1e-9

    def _go_quiet(self, now_s: float) -> None:
        if now_s - self._heard_s > self.config.stop_after_s:
            self.state = ArbiterState.STOPPED
            self.source = None
        elif self.state != ArbiterState.WAITING:
            self.state = ArbiterState.STALE

    def _where_they_stop(self, posture: Array, v_measured: Array) -> Array:
        robot = self._robot
        v = np.clip(v_measured, -robot.v_max, robot.v_max)
        wanted = self._target
        if not np.isfinite(v).all():
            return posture.copy()
        rest = np.clip(
            posture + v * np.abs(v) / (2.0 * _STOP_SHARE * robot.a_max),
            robot.q_lower,
            robot.q_upper,
        )
        ahead = ((wanted - posture) * v >= 0.0) | (
            np.abs(wanted - posture) < self.config.switch_step_max_rad
        )
        return np.where(
            ahead & ((rest - wanted) * v > 0.0),
            wanted,
            rest,
        )  # never beyond what was commanded
