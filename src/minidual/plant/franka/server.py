"""The emulator's network: two controllers on addresses of this machine, in one process.

Each arm has a TCP port for requests and sends its state over UDP; each hand likewise.
"""

import select
import threading
import time
from collections.abc import Sequence
from enum import StrEnum

from minidual import emergency
from minidual.errors import EnvironmentMissingError, UsageError
from minidual.plant.franka.cell import EmulatedCell
from minidual.plant.franka.served import ServedArm, ServedHand
from minidual.plant.franka.twin_port import TwinPort
from minidual.robot.pair import SIDES

HOSTS = ("127.0.0.1", "127.0.0.2")
_PERIOD_S = 1e-3
PATIENCE_S = 0.5
_BEHIND_MAX_S = 0.05


class Pace(StrEnum):
    """How the emulator's time passes.

    real: one millisecond of the wall each, as a controller's. client: as that, but it waits up to
    half a second for each command, so that a busy machine loses no packets.
    """

    REAL = "real"
    CLIENT = "client"


class EmulatorServer:
    """Serves a cell until it is closed.

    Args:
        cell: Arms, hands, world.
        hosts: Addresses of the left and right controller.
        pace: How its time passes.
        patience_s: How long it waits for a command, with pace `client`.

    Attributes:
        late_ticks: Milliseconds that took longer, with pace `real`.

    Raises:
        UsageError: There are not two different addresses.
        EnvironmentMissingError: A port is taken.
    """

    def __init__(
        self,
        cell: EmulatedCell,
        hosts: Sequence[str] = HOSTS,
        pace: Pace = Pace.REAL,
        patience_s: float = PATIENCE_S,
    ) -> None:
        if len(set(hosts)) != len(SIDES):
            raise UsageError(
                f"the emulator needs two different addresses, not {', '.join(hosts) or 'none'}",
                remedy="--hosts 127.0.0.1,127.0.0.2",
            )
        self.cell = cell
        self.hosts = tuple(hosts)
        self.pace = pace
        self._patience_s = patience_s
        self.late_ticks = 0
        self.arms: list[ServedArm] = []
        self.hands: list[ServedHand] = []
        self._twin: TwinPort | None = None
        try:
            for index, host in enumerate(hosts):
                self.arms.append(ServedArm(host, cell, index))
                self.hands.append(ServedHand(host, cell, index))
            self._twin = TwinPort(hosts[0], cell.world)
        except EnvironmentMissingError:
            self.close()
            raise
        self._due_s = time.perf_counter()

    def tick(self) -> None:
        """Run one millisecond; the emergency stop of this process presses both stop buttons."""
        if emergency.pressed():
            for arm in self.cell.arms:
                arm.user_stop(pressed=True)
        for served in (*self.arms, *self.hands):
            served.serve()
        self._await_commands()
        left, right = self.arms
        self.cell.step((left.take(), right.take()))
        for served in (*self.arms, *self.hands):
            served.send()
        if self._twin is not None:
            self._twin.serve()
        self._wait()

    def _await_commands(self) -> None:
        """Read the commands that answer the last states; wait for them with pace `client`."""
        missing = [arm for arm in self.arms if arm.expects and not arm.receive()]
        if self.pace is Pace.REAL:
            return
        deadline_s = time.perf_counter() + self._patience_s
        while missing:
            left_s = deadline_s - time.perf_counter()
            sockets = [arm.channel.udp for arm in missing if arm.channel.udp is not None]
            if left_s <= 0.0 or not sockets:
                return
            select.select(sockets, [], [], left_s)
            missing = [arm for arm in missing if not arm.receive()]

    def _wait(self) -> None:
        """Sleep until the next millisecond is due; a long delay is not caught up."""
        self._due_s += _PERIOD_S
        ahead_s = self._due_s - time.perf_counter()
        if ahead_s > 0.0:
            time.sleep(ahead_s)
            return
        self.late_ticks += 1
        if ahead_s < -_BEHIND_MAX_S or self.pace is Pace.CLIENT:
            self._due_s = time.perf_counter()

    def run(self, stop: threading.Event) -> None:
        """Serve until `stop` is set, then close."""
        try:
            while not stop.is_set():
                self.tick()
        finally:
            self.close()

    def close(self) -> None:
        """Close all clients and ports."""
        for served in (*self.arms, *self.hands):
            served.channel.close()
        if self._twin is not None:
            self._twin.close()
