"""The emulator's network: two controllers on addresses of this machine, in one process.

Each arm has a TCP port for requests and sends its state over UDP; each hand likewise.
"""

import select
import socket
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from enum import StrEnum

import numpy as np

from minidual.errors import EnvironmentMissingError, UsageError
from minidual.plant.franka import wire
from minidual.plant.franka.cell import EmulatedCell
from minidual.plant.franka.description import model_urdf
from minidual.plant.franka.wire import ArmCommand, HandCommand, Record, Request, RobotMode
from minidual.robot.pair import SIDES

HOSTS = ("127.0.0.1", "127.0.0.2")
_PERIOD_S = 1e-3
_PATIENCE_S = 0.05
_BEHIND_MAX_S = 0.05
_ARMS = tuple(range(len(SIDES)))


class Pace(StrEnum):
    """How the emulator's time passes.

    real: one millisecond of the wall each, as a controller's. client: as that, but it waits up to
    50 ms for each command, so that a busy machine loses no packets.
    """

    REAL = "real"
    CLIENT = "client"


class Channel:
    """One TCP port with one client, and the UDP socket of its states.

    Attributes:
        host, port: Where it listens.
        udp: Socket that sends states and gets commands, or None without a client.
        sent_id: Number of the last state.
    """

    def __init__(self, host: str, port: int, header: np.dtype[np.void]) -> None:
        self.host = host
        self.port = port
        self._header = header
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind((host, port))
        except OSError as error:
            self._listener.close()
            raise EnvironmentMissingError(
                f"the emulator cannot listen on {host}:{port}: {error.strerror}",
                remedy="end what uses it, or name other addresses with --hosts",
            ) from error
        self._listener.listen(1)
        self._listener.setblocking(False)
        self._client: socket.socket | None = None
        self._reader = wire.RequestReader(header)
        self._client_host = ""
        self._client_port = 0
        self.udp: socket.socket | None = None
        self.sent_id = 0

    def poll(self) -> tuple[list[Request], bool]:
        """Return new requests, and whether the client has gone."""
        if self._client is None:
            self._accept()
            return [], False
        try:
            data = self._client.recv(65536)
        except BlockingIOError:
            return [], False
        except OSError:
            data = b""
        if not data:
            self.drop()
            return [], True
        try:
            return self._reader.feed(data), False
        except wire.WireError:
            self.drop()
            return [], True

    def _accept(self) -> None:
        with suppress(BlockingIOError):
            client, address = self._listener.accept()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = client
            self._client_host = address[0]
            self._reader = wire.RequestReader(self._header)

    def begin_states(self, client_port: int) -> None:
        """Send states to a port of the client from now on."""
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.bind((self.host, 0))
        self.udp.setblocking(False)
        self._client_port = client_port

    def send_state(self, state: bytes) -> None:
        """Send a state, if there is a client; a full buffer loses it, as a network does."""
        if self.udp is not None:
            with suppress(OSError):
                self.udp.sendto(state, (self._client_host, self._client_port))

    def reply(self, command: int, command_id: int, payload: bytes) -> None:
        """Answer a request."""
        if self._client is None:
            return
        message = wire.answer(self._header, command, command_id, payload)
        try:
            self._client.setblocking(True)
            self._client.sendall(message)
            self._client.setblocking(False)
        except OSError:
            self.drop()

    def drop(self) -> None:
        """Let go of the client."""
        for each in (self._client, self.udp):
            if each is not None:
                each.close()
        self._client = None
        self.udp = None

    def close(self) -> None:
        """Stop listening."""
        self.drop()
        self._listener.close()


class _Arm:
    """One arm's channel and the motion that its client has asked for."""

    def __init__(self, host: str, cell: EmulatedCell, index: int) -> None:
        self.channel = Channel(host, wire.ARM_PORT, wire.ARM_HEADER)
        self._cell = cell
        self._index = index
        self.controller = cell.arms[index]
        self._move_id = 0
        self.newest: Record | None = None

    def serve(self) -> None:
        """Carry out new requests, and say how a motion ended."""
        requests, gone = self.channel.poll()
        if gone:
            self.controller.disconnected()
        for request in requests:
            with suppress(wire.WireError):
                self._carry_out(request)
        finished = self.controller.take_finished()
        if finished is not None:
            self.channel.reply(ArmCommand.MOVE, self._move_id, bytes([finished]))

    def _carry_out(self, request: Request) -> None:
        try:
            command = ArmCommand(request.command)
        except ValueError:
            return
        layout = wire.ARM_REQUESTS.get(command)
        record = None if layout is None else wire.parse(request.payload, layout)
        payload = self._answer(command, request, record)
        self.channel.reply(command, request.command_id, payload)

    def _answer(self, command: ArmCommand, request: Request, record: Record | None) -> bytes:
        """Return the payload of the answer."""
        controller = self.controller
        if record is None:
            if command is ArmCommand.STOP_MOVE:
                return bytes([controller.stop()])
            if command is ArmCommand.AUTOMATIC_ERROR_RECOVERY:
                return bytes([controller.recover()])
            urdf = model_urdf(self._cell.robot.arm)
            return bytes([0]) + urdf.encode("ascii")
        if command is ArmCommand.CONNECT:
            fits = int(record["version"]) == wire.ARM_VERSION
            if fits:
                self.channel.begin_states(int(record["udp_port"]))
            status = wire.ConnectStatus.SUCCESS if fits else wire.ConnectStatus.INCOMPATIBLE_VERSION
            return _record(wire.ARM_CONNECTED, status=status, version=wire.ARM_VERSION)
        if command is ArmCommand.MOVE:
            self._move_id = request.command_id
            return bytes([controller.move(int(record["controller"]), int(record["generator"]))])
        if command is ArmCommand.SET_COLLISION_BEHAVIOR:
            return bytes([controller.set_thresholds(record)])
        busy = controller.mode is RobotMode.MOVE
        status = wire.SetterStatus.NOT_POSSIBLE if busy else wire.SetterStatus.SUCCESS
        return bytes([status])

    @property
    def expects(self) -> bool:
        """Whether a client is to answer each state with a command."""
        return self.channel.udp is not None and self.controller.mode is RobotMode.MOVE

    def receive(self) -> bool:
        """Read commands; return whether the one that answers the last state has come."""
        udp = self.channel.udp
        while udp is not None:
            try:
                data = udp.recv(4096)
            except OSError:
                break
            with suppress(wire.WireError):
                command = wire.parse(data, wire.ARM_COMMAND)
                if int(command["message_id"]) == self.channel.sent_id:
                    self.newest = command
        return self.newest is not None

    def take(self) -> Record | None:
        """Return the command of this millisecond, once."""
        command = self.newest
        self.newest = None
        return command

    def send(self) -> None:
        """Send the state."""
        self.channel.sent_id = self._cell.time_ms
        if self.channel.udp is not None:
            self.channel.send_state(self._cell.arm_state(self._index, self._cell.time_ms))


class _Hand:
    """One hand's channel and the command that it carries out."""

    def __init__(self, host: str, cell: EmulatedCell, index: int) -> None:
        self.channel = Channel(host, wire.HAND_PORT, wire.HAND_HEADER)
        self._cell = cell
        self._index = index
        self.controller = cell.hands[index]
        self._pending = (0, 0)

    def serve(self) -> None:
        """Carry out new requests, and say how a command ended."""
        requests, _ = self.channel.poll()
        for request in requests:
            with suppress(wire.WireError):
                self._carry_out(request)
        finished = self.controller.take_finished()
        if finished is not None:
            self.channel.reply(*self._pending, _record(np.dtype([("s", "<u2")]), s=finished))

    def _carry_out(self, request: Request) -> None:
        try:
            command = HandCommand(request.command)
        except ValueError:
            return
        layout = wire.HAND_REQUESTS.get(command)
        record = None if layout is None else wire.parse(request.payload, layout)
        if command is HandCommand.CONNECT and record is not None:
            self.channel.begin_states(int(record["udp_port"]))
            payload = _record(wire.HAND_CONNECTED, status=0, version=wire.HAND_VERSION)
            self.channel.reply(command, request.command_id, payload)
            return
        if command is HandCommand.STOP:
            self.controller.stop()
            self._refuse(command, request, wire.HandStatus.SUCCESS)
            return
        refusal = None
        if command is HandCommand.HOMING or record is None:
            self.controller.home()
        elif command is HandCommand.GRASP:
            refusal = self.controller.grasp(record)
        else:
            refusal = self.controller.move(record)
        if refusal is not None:
            self._refuse(command, request, refusal)
            return
        self._pending = (command, request.command_id)

    def _refuse(self, command: int, request: Request, status: wire.HandStatus) -> None:
        payload = _record(np.dtype([("s", "<u2")]), s=status)
        self.channel.reply(command, request.command_id, payload)

    def send(self) -> None:
        """Send the state."""
        if self.channel.udp is not None:
            self.channel.send_state(self._cell.hand_state(self._index, self._cell.time_ms))


class EmulatorServer:
    """Serves a cell until it is closed.

    Args:
        cell: Arms, hands, world.
        hosts: Addresses of the left and right controller.
        pace: How its time passes.

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
    ) -> None:
        if len(set(hosts)) != len(SIDES):
            raise UsageError(
                f"the emulator needs two different addresses, not {', '.join(hosts) or 'none'}",
                remedy="--hosts 127.0.0.1,127.0.0.2",
            )
        self.cell = cell
        self.hosts = tuple(hosts)
        self.pace = pace
        self.late_ticks = 0
        self.arms: list[_Arm] = []
        self.hands: list[_Hand] = []
        try:
            for index, host in enumerate(hosts):
                self.arms.append(_Arm(host, cell, index))
                self.hands.append(_Hand(host, cell, index))
        except EnvironmentMissingError:
            self.close()
            raise
        self._due_s = time.perf_counter()

    def tick(self) -> None:
        """Run one millisecond."""
        for served in (*self.arms, *self.hands):
            served.serve()
        self._await_commands()
        left, right = self.arms
        self.cell.step((left.take(), right.take()))
        for served in (*self.arms, *self.hands):
            served.send()
        self._wait()

    def _await_commands(self) -> None:
        """Read the commands that answer the last states; wait for them with pace `client`."""
        missing = [arm for arm in self.arms if arm.expects and not arm.receive()]
        if self.pace is Pace.REAL:
            return
        deadline_s = time.perf_counter() + _PATIENCE_S
        while missing:
            left_s = deadline_s - time.perf_counter()
            sockets = [arm.channel.udp for arm in missing if arm.channel.udp is not None]
            if left_s <= 0.0 or not sockets:
                return
            select.select(sockets, [], [], left_s)
            missing = [arm for arm in missing if not arm.receive()]

    def _wait(self) -> None:
        """Sleep until the next millisecond is due; what is far behind is not caught up."""
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
        """Let go of all clients and ports."""
        for served in (*self.arms, *self.hands):
            served.channel.close()


def _record(layout: np.dtype[np.void], **values: int) -> bytes:
    record = np.zeros((), layout)
    for name, value in values.items():
        record[name] = value
    return record.tobytes()
