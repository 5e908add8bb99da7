"""A plain client of the emulator: bytes over sockets, in the process of the server."""

from __future__ import annotations

import socket

import numpy as np

from minidual.plant.franka import wire
from minidual.plant.franka.server import EmulatorServer


class RawClient:
    """Speaks to one arm; the server is ticked between its calls."""

    def __init__(self, server: EmulatorServer, index: int = 0, version: int = 10) -> None:
        self.server = server
        self._host = server.hosts[index]
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.bind(("", 0))
        self.udp.setblocking(False)
        self.tcp = socket.create_connection((self._host, wire.ARM_PORT), timeout=5.0)
        self.tcp.setblocking(False)
        self._bytes = b""
        self._ids = 0
        self._from: tuple[str, int] | None = None
        self._newest: np.void | None = None
        self.answers: list[tuple[int, int, bytes]] = []
        port = self.udp.getsockname()[1]
        self.connected = self.request(
            wire.ArmCommand.CONNECT, wire.CONNECT, version=version, udp_port=port
        )

    def send(self, command: int, layout: np.dtype | None = None, **values: object) -> int:
        payload = b""
        if layout is not None:
            record = np.zeros((), layout)
            for name, value in values.items():
                record[name] = value
            payload = record.tobytes()
        self._ids += 1
        self.tcp.sendall(wire.answer(wire.ARM_HEADER, command, self._ids, payload))
        return self._ids

    def request(self, command: int, layout: np.dtype | None = None, **values: object) -> bytes:
        """Send a request and tick the server until its answer has come."""
        number = self.send(command, layout, **values)
        for _ in range(100):
            self.server.tick()
            self.collect()
            for answer in self.answers:
                if answer[:2] == (command, number):
                    self.answers.remove(answer)
                    return answer[2]
        raise AssertionError(f"no answer to {command}")

    def collect(self) -> None:
        try:
            self._bytes += self.tcp.recv(1 << 20)
        except BlockingIOError:
            return
        size_of_header = wire.ARM_HEADER.itemsize
        while len(self._bytes) >= size_of_header:
            head = np.frombuffer(self._bytes[:size_of_header], wire.ARM_HEADER)[0]
            size = int(head["size"])
            if len(self._bytes) < size:
                return
            payload = self._bytes[size_of_header:size]
            self.answers.append((int(head["command"]), int(head["command_id"]), payload))
            self._bytes = self._bytes[size:]

    def state(self) -> np.void:
        """Return the newest state that has come."""
        while True:
            try:
                data, self._from = self.udp.recvfrom(4096)
            except BlockingIOError:
                break
            self._newest = np.frombuffer(data, wire.ARM_STATE)[0]
        assert self._newest is not None, "no state came"
        return self._newest

    def command(self, state: np.void, **values: object) -> None:
        record = np.zeros((), wire.ARM_COMMAND)
        record["message_id"] = state["message_id"]
        for name, value in values.items():
            record[name] = value
        self.udp.sendto(record.tobytes(), self._from)

    def move(self, controller: int, generator: int) -> int:
        """Start a motion; return its status."""
        answer = self.request(
            wire.ArmCommand.MOVE, wire.MOVE, controller=controller, generator=generator
        )
        return answer[0]

    def close(self) -> None:
        self.tcp.close()
        self.udp.close()
