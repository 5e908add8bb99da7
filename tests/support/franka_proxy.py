"""A network between client and emulator, in a process of its own: it cuts, delays and reorders.

    python -m tests.support.franka_proxy PROXY,PROXY SERVER,SERVER

Lines on stdin change it, with ARM 0 (left) or 1 (right), and are answered by "done":

    cut ARM N       drop the next N states of an arm on their way to the client
    delay ARM MS    hold back what is sent either way
    swap ARM N      let each of the next N commands overtake the one before it

An arm that is cut gets no answers for so many milliseconds of the emulator's time.
"""

from __future__ import annotations

import selectors
import socket
import sys
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from minidual.plant.franka import wire
from minidual.plant.franka.twin_messages import TWIN_PORT

_PORTS = {wire.ARM_PORT: wire.ARM_HEADER, wire.HAND_PORT: wire.HAND_HEADER}


@dataclass
class Weather:
    """What the network of one arm does."""

    cut_n: int = 0
    delay_s: float = 0.0
    swap_n: int = 0


@dataclass
class Pair:
    """One connection: TCP both ways, states to the client, commands to the server."""

    client: socket.socket
    server: socket.socket
    states: socket.socket
    commands: socket.socket
    weather: Weather
    client_at: tuple[str, int] | None = None
    server_at: tuple[str, int] | None = None
    held: bytes | None = None
    late: deque[tuple[float, Callable[[], object]]] = field(default_factory=deque)

    def later(self, send: Callable[[], object]) -> None:
        if self.weather.delay_s == 0.0 and not self.late:
            send()
        else:
            self.late.append((time.monotonic() + self.weather.delay_s, send))

    def flush(self) -> None:
        while self.late and self.late[0][0] <= time.monotonic():
            self.late.popleft()[1]()


class Proxy:
    """Listens on the proxies' addresses and connects to the servers'."""

    def __init__(self, proxies: list[str], servers: list[str]) -> None:
        self.weathers = [Weather() for _ in proxies]
        self._chosen = selectors.DefaultSelector()
        self._pairs: list[Pair] = []
        for arm, (proxy, server) in enumerate(zip(proxies, servers, strict=True)):
            for port in _PORTS:
                listener = socket.create_server((proxy, port))
                self._watch(
                    listener,
                    lambda listener=listener, arm=arm, server=server, port=port: self._accept(
                        listener, arm, server, port
                    ),
                )
        twin = socket.create_server((proxies[0], TWIN_PORT))
        self._watch(twin, lambda: self._accept_twin(twin, servers[0]))
        self._watch(sys.stdin, self._order)

    def _watch(self, file: object, act: Callable[[], object]) -> None:
        self._chosen.register(file, selectors.EVENT_READ, act)  # type: ignore[arg-type]

    def run(self) -> None:
        while True:
            waits = any(pair.late for pair in self._pairs)
            for key, _ in self._chosen.select(0.0005 if waits else 0.05):
                key.data()
            for pair in self._pairs:
                pair.flush()

    def _order(self) -> None:
        line = sys.stdin.readline()
        if not line:
            sys.exit()
        name, arm, number = line.split()
        weather = self.weathers[int(arm)]
        if name == "cut":
            weather.cut_n = int(number)
        elif name == "delay":
            weather.delay_s = 1e-3 * float(number)
        else:
            weather.swap_n = int(number)
        print("done", flush=True)

    def _accept_twin(self, listener: socket.socket, server: str) -> None:
        """Pass the emulator's window through: no network is between judge and truth."""
        client, _ = listener.accept()
        upstream = socket.create_connection((server, TWIN_PORT))

        def passed(source: socket.socket, sink: socket.socket) -> None:
            data = _received(source)
            if data:
                sink.sendall(data)
                return
            for each in (client, upstream):
                self._chosen.unregister(each)
                each.close()

        self._watch(client, lambda: passed(client, upstream))
        self._watch(upstream, lambda: passed(upstream, client))

    def _accept(self, listener: socket.socket, arm: int, server: str, port: int) -> None:
        client, (client_host, _) = listener.accept()
        upstream = socket.create_connection((server, port))
        states = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        states.bind(("127.0.0.1", 0))
        commands = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        commands.bind((listener.getsockname()[0], 0))
        weather = self.weathers[arm] if port == wire.ARM_PORT else Weather()
        pair = Pair(client, upstream, states, commands, weather)
        self._pairs.append(pair)
        reader = wire.RequestReader(_PORTS[port])

        def end() -> None:
            for each in (client, upstream, states, commands):
                self._chosen.unregister(each)
                each.close()
            self._pairs.remove(pair)

        def requests() -> None:
            data = _received(client)
            if not data:
                end()
                return
            for request in reader.feed(data):
                payload = request.payload
                if request.command == 0:  # connect: states are to come here
                    record = np.frombuffer(payload, wire.CONNECT)[0].copy()
                    pair.client_at = (client_host, int(record["udp_port"]))
                    record["udp_port"] = states.getsockname()[1]
                    payload = record.tobytes()
                header = _PORTS[port]
                message = wire.answer(header, request.command, request.command_id, payload)
                pair.later(lambda message=message: upstream.sendall(message))

        def answers() -> None:
            data = _received(upstream)
            if not data:
                end()
                return
            pair.later(lambda: client.sendall(data))

        def state() -> None:
            data, pair.server_at = states.recvfrom(4096)
            if weather.cut_n > 0:
                weather.cut_n -= 1
                return
            pair.later(lambda: commands.sendto(data, pair.client_at))

        def command() -> None:
            data, _ = commands.recvfrom(4096)
            if weather.swap_n > 0 and pair.held is None:
                pair.held = data
                return
            pair.later(lambda: states.sendto(data, pair.server_at))
            if pair.held is not None:
                weather.swap_n -= 1
                held, pair.held = pair.held, None
                pair.later(lambda: states.sendto(held, pair.server_at))

        self._watch(client, requests)
        self._watch(upstream, answers)
        self._watch(states, state)
        self._watch(commands, command)


def _received(stream: socket.socket) -> bytes:
    try:
        return stream.recv(1 << 16)
    except OSError:
        return b""


if __name__ == "__main__":
    made = Proxy(*(hosts.split(",") for hosts in sys.argv[1:3]))
    print("ready", flush=True)
    made.run()
