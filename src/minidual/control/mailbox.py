"""Latest valid command of one source, per arm."""

import copy
from dataclasses import replace

import numpy as np

from minidual.control.command_checks import check
from minidual.control.commands import Command, JointCommand, ObjectCommand, Refusal, TimedCommand
from minidual.robot.pair import Robot


class Mailbox:
    """Keeps the newest command per arm."""

    def __init__(self, source: str, robot: Robot) -> None:
        self.source, self._robot = source, robot
        self._latest: dict[int, JointCommand] = {}
        self._timed: list[TimedCommand] = []
        self._sequence: int | None = None
        self._not_before_s = float("-inf")

    def put(self, command: Command) -> Refusal | None:
        """Accept a command, or return its refusal."""
        reason = check(command, self._robot)
        if reason is None and command.stamp_s < self._not_before_s:
            before = f"before the switch at {self._not_before_s:.4f} s"
            reason = "before_switch", f"stamped {command.stamp_s:.4f} s, {before}"
        if reason is None and self._sequence is not None and command.sequence <= self._sequence:
            reason = "out_of_order", f"sequence {command.sequence} after {self._sequence}"
        if reason is not None:
            return Refusal(self.source, *reason)
        self._sequence, command = command.sequence, _own(command)
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

    def fresh(self, now_s: float, stale_s: float) -> tuple[dict[int, JointCommand], list[Refusal]]:
        """Return each arm's command at most `stale_s` old, and refusals.

        Stamps over `stale_s` ahead are dropped.
        """
        refusals = [r for c in self._latest.values() if (r := self._from_future(c, now_s, stale_s)) is not None]
        self._latest = {arm: c for arm, c in sorted(self._latest.items()) if c.stamp_s - now_s <= stale_s}
        return {arm: c for arm, c in self._latest.items() if now_s - c.stamp_s <= stale_s + 1e-9}, refusals

    def take_timed(self, now_s: float, stale_s: float) -> tuple[list[TimedCommand], list[Refusal]]:
        """Remove and return the waiting timed commands, and refusals."""
        waiting, self._timed = self._timed, []
        taken: list[TimedCommand] = []
        refusals: list[Refusal] = []
        for command in waiting:
            age_s, refusal = now_s - command.stamp_s, self._from_future(command, now_s, stale_s)
            if age_s > stale_s + 1e-9:
                detail = f"{type(command).__name__} is {age_s:.3f} s old; limit {stale_s} s"
                refusal = Refusal(self.source, "stale", detail)
            if refusal is None:
                taken.append(command)
            else:
                refusals.append(refusal)
        return taken, refusals

    def _from_future(self, command: Command, now_s: float, stale_s: float) -> Refusal | None:
        ahead_s = command.stamp_s - now_s
        if ahead_s <= stale_s:
            return None
        stamped = f"stamped {command.stamp_s:.4f} s, {ahead_s:.4f} s ahead of the clock"
        return Refusal(self.source, "from_future", f"{type(command).__name__}: {stamped}")


def _own(command: Command) -> Command:
    if isinstance(command, ObjectCommand):
        return replace(command, gripper=np.array(command.gripper, dtype=float))
    return copy.deepcopy(command)
