"""Latest valid command of one source, per arm."""

from __future__ import annotations

from minidual.control.command_checks import find_fault
from minidual.control.commands import Command, JointCommand, Refusal, TimedCommand
from minidual.robot.pair import SIDES, Robot


class Mailbox:
    """Keeps the newest command per arm.

    Commands stamped before a `flush` are refused afterwards, so a late action chunk never runs.
    """

    def __init__(self, source: str, robot: Robot) -> None:
        self.source, self._robot = source, robot
        self._latest: dict[int, JointCommand] = {}
        self._timed: list[TimedCommand] = []
        self._sequence: int | None = None
        self._not_before_s = float("-inf")

    def put(self, command: Command) -> Refusal | None:
        """Accept a command, or return its refusal."""
        fault = find_fault(command, self._robot)
        if fault is None and command.stamp_s < self._not_before_s:
            fault = (
                "before_switch",
                f"stamped {command.stamp_s:.4f} s, before the switch at {self._not_before_s:.4f} s",
            )
        if fault is None and self._sequence is not None and command.sequence <= self._sequence:
            fault = ("out_of_order", f"sequence {command.sequence} after {self._sequence}")
        if fault is not None:
            return Refusal(self.source, *fault)
        self._sequence = command.sequence
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
        """Forget all commands; refuse earlier stamps from now on."""
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
        fresh: dict[int, JointCommand] = {}
        refusals: list[Refusal] = []
        for arm, command in sorted(self._latest.items()):
            age = now_s - command.stamp_s
            if age < -stale_s:
                refusals.append(self._ahead(f"{SIDES[arm]} arm", -age, command))
                del self._latest[arm]
            elif age <= stale_s + 1e-9:
                fresh[arm] = command
        return fresh, refusals

    def take_timed(self, now_s: float, stale_s: float) -> tuple[list[TimedCommand], list[Refusal]]:
        """Remove and return the waiting timed commands, and refusals."""
        waiting, self._timed = self._timed, []
        taken: list[TimedCommand] = []
        refusals: list[Refusal] = []
        for command in waiting:
            age = now_s - command.stamp_s
            if age < -stale_s:
                refusals.append(self._ahead(type(command).__name__, -age, command))
            elif age > stale_s + 1e-9:
                detail = f"{type(command).__name__} is {age:.3f} s old; limit {stale_s} s"
                refusals.append(Refusal(self.source, "stale", detail))
            else:
                taken.append(command)
        return taken, refusals

    def _ahead(self, what: str, ahead_s: float, command: Command) -> Refusal:
        detail = f"{what}: stamped {command.stamp_s:.4f} s, {ahead_s:.4f} s ahead of the clock"
        return Refusal(self.source, "from_future", detail)
