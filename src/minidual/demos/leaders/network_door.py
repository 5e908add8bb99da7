"""Doors through which messages of a program that leads come in: UDP datagrams or a WebSocket."""

import socket
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import NamedTuple

from minidual.config.leading import NetworkConfig
from minidual.errors import EnvironmentMissingError

MESSAGE_MAX_BYTES = 65_535
PER_READ_MAX = 1000
"""Messages taken in one reading: a flood must not stop the loop."""


class Parcel(NamedTuple):
    """A message that came.

    Attributes:
        data: As it came; nothing is checked.
        answer: Sends a text to who sent it, without waiting; returns whether it could be sent.
    """

    data: bytes
    answer: Callable[[str], bool]


class Door(ABC):
    """Listens at a port.

    Attributes:
        port: That it listens at.
    """

    port: int

    @abstractmethod
    def parcels(self) -> Iterator[Parcel]:
        """Yield the messages that have come since the last call, oldest first, without waiting."""

    @abstractmethod
    def close(self) -> None:
        """Free the port."""


class UdpDoor(Door):
    """One message a datagram.

    Raises:
        EnvironmentMissingError: The port is taken, or the interface does not exist.
    """

    def __init__(self, config: NetworkConfig) -> None:
        family = socket.AF_INET6 if ":" in config.host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.bind((config.host, config.port))
        except OSError as error:
            self._socket.close()
            raise cannot_listen(config, "UDP", error) from error
        self._socket.setblocking(False)
        self.port = self._socket.getsockname()[1]

    def parcels(self) -> Iterator[Parcel]:
        """See `Door`."""
        for _ in range(PER_READ_MAX):
            try:
                data, address = self._socket.recvfrom(MESSAGE_MAX_BYTES)
            except BlockingIOError:
                return
            except OSError:  # an earlier answer was refused by its receiver
                continue
            yield Parcel(data, self._answering(address))

    def _answering(self, address: tuple[str, int]) -> Callable[[str], bool]:
        def answer(text: str) -> bool:
            try:
                self._socket.sendto(text.encode(), address)
            except OSError:
                return False
            return True

        return answer

    def close(self) -> None:
        """See `Door`."""
        self._socket.close()


def cannot_listen(
    config: NetworkConfig,
    protocol: str,
    error: OSError,
) -> EnvironmentMissingError:
    """Return the error of a port that cannot be listened on."""
    reason = error.strerror or str(error)
    return EnvironmentMissingError(
        f"the network leader cannot listen at {config.host}, {protocol} port {config.port}: "
        f"{reason}",
        remedy="--set teleop.network.port=N, or teleop.network.host=127.0.0.1",
    )
