"""One port of an emulated controller: its TCP requests and the UDP socket of its states."""

import socket
from contextlib import suppress

import numpy as np

from minidual.errors import EnvironmentMissingError
from minidual.plant.franka import wire
from minidual.plant.franka.wire import Request

_ACCEPT_EVERY = 20
"""A new client is looked for once in so many milliseconds."""


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
        self._unasked = 0
        self._reader = wire.RequestReader(header)
        self._client_host = ""
        self._client_port = 0
        self.udp: socket.socket | None = None
        self.sent_id = 0

    def poll(self) -> tuple[list[Request], bool]:
        """Return new requests, and whether the client has gone."""
        if self._client is None:
            self._unasked = (self._unasked + 1) % _ACCEPT_EVERY
            if self._unasked == 0:
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
        """Close the connection to the client."""
        for each in (self._client, self.udp):
            if each is not None:
                each.close()
        self._client = None
        self.udp = None

    def close(self) -> None:
        """Stop listening."""
        self.drop()
        self._listener.close()
