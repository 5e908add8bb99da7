"""How one source drives: its streamed and timed commands, and its silence."""

from collections.abc import Callable

import numpy as np

from minidual.config.control import ArbiterConfig
from minidual.control.commands import HOLD, ArbiterState, JointCommand
from minidual.control.execution import Underway
from minidual.control.joint_target import ARMS, JointTarget
from minidual.control.mailbox import Mailbox
from minidual.robot.pair import SIDES, Array

Refuse = Callable[[str, str, str], object]
"""Notes a refusal: source, name, detail."""


class Driving:
    """What the driving source's commands do to the target, the hands and the arbiter's state.

    Attributes:
        source: Source that may drive, or None.
        state: State of the arbiter.
        gripper: Commanded openings (2,).
        heard_s: Time of the newest streamed command, or of the last tick with a running timed one.
        alive_s: When the source was last known to live.
    """

    def __init__(
        self,
        config: ArbiterConfig,
        underway: Underway,
        gripper: Array,
        refuse: Refuse,
    ) -> None:
        self._config = config
        self._underway = underway
        self._refuse = refuse
        self.gripper = gripper
        self.source: str | None = None
        self.state = ArbiterState.HOLDING
        self.heard_s = 0.0
        self.alive_s = -np.inf
        self._streamed = set[int]()
        """Arms with a fresh streamed command."""

    def flush(self) -> None:
        """Forget which arms were streamed to."""
        self._streamed = set()

    def is_gone(self, now_s: float) -> bool:
        """Return whether the source has been silent for longer than `stale_s`."""
        return now_s - self.alive_s > self._config.stale_s + 1e-9

    # All that one tick knows; none of it is kept.
    def tick(
        self,
        mailbox: Mailbox,
        target: JointTarget,
        now_s: float,
        dt: float,
        speed: float,
        q: Array,
        v: Array,
    ) -> bool:
        """Take the source's commands at measured q, v (n,); return whether one passed."""
        self._begin_timed(mailbox, now_s, q, v)
        streamed = self._streamed
        passed = self._drive(mailbox, target, now_s, dt, speed)
        silent = streamed - self._streamed
        if silent or target.stopping:
            self._stop_silent(target, silent, target.stopped(q, v))
        return passed

    def _begin_timed(self, mailbox: Mailbox, now_s: float, q: Array, v: Array) -> None:
        far_rad = self._config.switch_step_max_rad
        for command in mailbox.take_timed(now_s, self._config.stale_s):
            reason = self._underway.begin(command, q, v, far_rad, self.gripper)
            if reason:
                self._refuse(self.source or HOLD, *reason)
                continue
            self.alive_s = max(self.alive_s, min(now_s, command.stamp_s))
            for arm in command.arms:
                self.gripper[arm] = command.gripper[arm]

    def _fresh(self, mailbox: Mailbox, now_s: float) -> dict[int, JointCommand]:
        """Return the source's streamed commands by arm that may drive now."""
        fresh = mailbox.fresh(now_s, self._config.stale_s)
        for arm, command in list(fresh.items()):
            reason = self._underway.busy((arm,)) or self._underway.admit(command)
            if reason is not None:
                self._refuse(self.source or HOLD, *reason)
                mailbox.drop(arm)
                del fresh[arm]
        return fresh

    def _drive(
        self,
        mailbox: Mailbox,
        target: JointTarget,
        now_s: float,
        dt: float,
        speed: float,
    ) -> bool:
        """Move the target by the source's commands; return whether one passed."""
        fresh = self._fresh(mailbox, now_s)
        self._streamed = set(fresh)
        if fresh:
            newest_s = max(command.stamp_s for command in fresh.values())
            self.heard_s = max(self.heard_s, newest_s)
            self.alive_s = max(self.alive_s, min(now_s, newest_s))
        driven = self._run_timed(now_s)
        if not fresh:
            if not driven:
                self._go_quiet(now_s)
            return driven
        target.aligning = self.state == ArbiterState.ALIGNING
        follows = target.approach(fresh, dt, speed)
        self.state = ArbiterState.ACTIVE if follows else ArbiterState.ALIGNING
        if follows:  # aligning hands do not move, so that they keep what they hold
            for arm, command in fresh.items():
                self.gripper[arm] = command.gripper[arm]
        return True

    def _run_timed(self, now_s: float) -> bool:
        """Return whether timed commands run; brake them if their source is gone."""
        if not self._underway.executions:
            return False
        if self.is_gone(now_s):
            self._underway.brake()
        if self._underway.braking:
            self.state = ArbiterState.STALE
            return False
        self.heard_s = now_s
        self.state = ArbiterState.ACTIVE
        return True

    def _go_quiet(self, now_s: float) -> None:
        if now_s - self.heard_s > self._config.stop_after_s:
            self.state = ArbiterState.STOPPED
            self.source = None
        elif self.state != ArbiterState.WAITING:
            self.state = ArbiterState.STALE

    def _stop_silent(self, target: JointTarget, silent: set[int], rest: Array) -> None:
        """Bring arms whose source has gone silent to rest."""
        idle = {arm for arm in ARMS - self._streamed if not self._underway.busy((arm,))}
        if self.state not in (ArbiterState.ACTIVE, ArbiterState.ALIGNING):
            target.stop_all(idle, silent, rest)
            return
        for arm in target.stop_arms(idle, silent, rest):
            detail = f"{SIDES[arm]} arm: no command for {self._config.stale_s} s"
            self._refuse(self.source or HOLD, "stale", detail)
