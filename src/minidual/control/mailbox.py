"""The newest valid command of one source, per arm."""

import copy
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from minidual.control.command_checks import check
from minidual.control.commands import (
    Command,
    JointCommand,
    ObjectCommand,
    Reason,
    TimedCommand,
)
from minidual.robot.pair import Robot


class Mailbox:
    """Keeps the newest command per arm; passes the reason for one that is too late or early to `refuse`."""

    def __init__(self, robot: Robot, refuse: Callable[[str, str], object]) -> None:
        self._robot = robot
        self._refuse = refuse
        self._latest: dict[int, JointCommand] = {}
        self._timed: list[TimedCommand] = []
        self._sequence: int | None = None
        self._not_before_s = float("-inf")

    def put(self, command: Command) -> Reason | None:
        """Accept a command, or return why not."""
        reason = check(command, self._robot)
        if reason is not None:
            return reason
        if command.stamp_s < self._not_before_s:
            switch = f"before the switch at {self._not_before_s:.4f} s"
            return "before_switch", f"stamped {command.stamp_s:.4f} s, {switch}"
        if self._sequence is not None and command.sequence <= self._sequence:
            return "out_of_order", f"sequence {command.sequence} after {self._sequence}"
        self._sequence = command.sequence
        command = _own(command)
        arms = set(command.arms)
        self._timed = [c for c in self._timed if not arms & set(c.arms)]
        if isinstance(command, JointCommand):
            for arm in command.arms:
                self._latest[arm] = command
        else:
            for arm in command.arms:
                self._latest.pop(arm, None)
            self._timed.append(command)
        return None

    def flush(self, now_s: float) -> None:
        """Forget all commands and refuse earlier stamps: a late action chunk never runs."""
        self._latest.clear()
        self._timed.clear()
        self._sequence = None
        self._not_before_s = now_s

    def drop(self, arm: int) -> None:
        """Forget an arm's streamed command."""
        self._latest.pop(arm, None)

    def fresh(self, now_s: float, stale_s: float) -> dict[int, JointCommand]:
        """Return each arm's command at most `stale_s` old; stamps over `stale_s` ahead are dropped."""
        due = {arm: c for arm, c in self._latest.items() if self._is_due(c, now_s, stale_s)}
        self._latest = dict(sorted(due.items()))
        return {arm: c for arm, c in self._latest.items() if now_s - c.stamp_s <= stale_s + 1e-9}

    def take_timed(self, now_s: float, stale_s: float) -> list[TimedCommand]:
        """Remove and return the waiting timed commands."""
        waiting = self._timed
        self._timed = []
        taken: list[TimedCommand] = []
        for command in waiting:
            age_s = now_s - command.stamp_s
            if age_s > stale_s + 1e-9:
                age = f"{type(command).__name__} is {age_s:.3f} s old"
                self._refuse("stale", f"{age}; limit {stale_s} s")
            elif self._is_due(command, now_s, stale_s):
                taken.append(command)
        return taken

    def _is_due(self, command: Command, now_s: float, stale_s: float) -> bool:
        ahead_s = command.stamp_s - now_s
        if ahead_s > stale_s:
            stamped = f"stamped {command.stamp_s:.4f} s, {ahead_s:.4f} s ahead of the clock"
            self._refuse("from_future", f"{type(command).__name__}: {stamped}")
        return ahead_s <= stale_s


def _own(command: Command) -> Command:
    """Return a copy that its sender cannot change."""
    if isinstance(command, ObjectCommand):
        return replace(command, gripper=np.array(command.gripper, dtype=float))
    return copy.deepcopy(command)
