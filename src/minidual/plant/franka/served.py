"""Answers of the emulator to requests to an arm and to a hand, each over its channel."""

from contextlib import suppress

import numpy as np

from minidual.plant.franka import wire
from minidual.plant.franka.cell import EmulatedCell
from minidual.plant.franka.channel import Channel
from minidual.plant.franka.description import model_urdf
from minidual.plant.franka.wire import ArmCommand, HandCommand, Record, Request, RobotMode

_AT_REST = (ArmCommand.MOVE, ArmCommand.AUTOMATIC_ERROR_RECOVERY)
"""Requests that wait until an arm that brakes has come to rest."""
_HAND_ANSWER = np.dtype([("status", "<u2")])


class ServedArm:
    """One arm's channel and the motion that its client has asked for."""

    def __init__(self, host: str, cell: EmulatedCell, index: int) -> None:
        self.channel = Channel(host, wire.ARM_PORT, wire.ARM_HEADER)
        self._cell = cell
        self._index = index
        self.controller = cell.arms[index]
        self._move_id = 0
        self._waiting: list[Request] = []
        self.newest: Record | None = None

    def serve(self) -> None:
        """Carry out new requests, and say how a motion ended."""
        requests, disconnected = self.channel.poll()
        if disconnected:
            self.controller.disconnected()
            self._waiting.clear()
        requests = [*self._waiting, *requests]
        self._waiting.clear()
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
        if command in _AT_REST and self.controller.is_braking:
            self._waiting.append(request)
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


class ServedHand:
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
            self.channel.reply(*self._pending, _record(_HAND_ANSWER, status=finished))

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
        payload = _record(_HAND_ANSWER, status=status)
        self.channel.reply(command, request.command_id, payload)

    def send(self) -> None:
        """Send the state."""
        if self.channel.udp is not None:
            self.channel.send_state(self._cell.hand_state(self._index, self._cell.time_ms))


def _record(layout: np.dtype[np.void], **values: int) -> bytes:
    record = np.zeros((), layout)
    for name, value in values.items():
        record[name] = value
    return record.tobytes()
