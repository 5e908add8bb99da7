"""The emulator's window: it shows its world to one client, which judges and films, and moves objects."""

import json
import socket
from contextlib import suppress

import numpy as np

from minidual.errors import EnvironmentMissingError, UsageError
from minidual.plant.franka.twin_messages import (
    TWIN_PORT,
    Kind,
    Message,
    MessageError,
    MessageReader,
    packed,
)
from minidual.plant.twin import put_down, state_of
from minidual.plant.world import World
from minidual.robot.pair import Array

_ACCEPT_EVERY = 20
"""A new client is looked for once in so many milliseconds."""
_HELD_N = 1.0
"""Pinch of a hand that holds an object."""


class TwinPort:
    """One TCP port with one client.

    Args:
        host: Address of the left controller.
        world: The emulator's.

    Raises:
        EnvironmentMissingError: The port is taken.
    """

    def __init__(self, host: str, world: World) -> None:
        self._world = world
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind((host, TWIN_PORT))
        except OSError as error:
            self._listener.close()
            raise EnvironmentMissingError(
                f"the emulator cannot listen on {host}:{TWIN_PORT}: {error.strerror}",
                remedy="end what uses it, or name other addresses with --hosts",
            ) from error
        self._listener.listen(1)
        self._listener.setblocking(False)
        self._client: socket.socket | None = None
        self._reader = MessageReader()
        self._ticks = 0

    def serve(self) -> None:
        """Answer the client's requests; to be called after each step of the world."""
        if self._client is None:
            self._ticks = (self._ticks + 1) % _ACCEPT_EVERY
            if self._ticks == 0:
                self._accept()
            return
        try:
            data = self._client.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self.drop()
            return
        try:
            messages = self._reader.feed(data)
        except MessageError:
            self.drop()
            return
        for message in messages:
            self._reply(self._answer(message))

    def _accept(self) -> None:
        with suppress(BlockingIOError):
            client, _ = self._listener.accept()
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            client.setblocking(False)
            self._client = client
            self._reader = MessageReader()

    def _answer(self, message: Message) -> bytes:
        world = self._world
        if message.kind is Kind.STATE:
            return packed(Kind.STATE, state_of(world).tobytes())
        if message.kind is Kind.SCENE:
            scene = {"robot": world.robot.name, "scene": world.scene.model_dump(mode="json")}
            return packed(Kind.SCENE, json.dumps(scene).encode())
        try:
            self._place(json.loads(message.body))
        except UsageError as error:
            return packed(Kind.REFUSED, error.message.encode())
        except (ValueError, TypeError, AttributeError) as error:
            return packed(Kind.REFUSED, f"no poses by name: {error}".encode())
        return packed(Kind.PLACE)

    def _place(self, poses: dict[str, list[float]]) -> None:
        """Put objects at (x, y, yaw), or at the 16 numbers of a pose.

        Raises:
            UsageError: An object is unknown, or a hand holds it.
        """
        places: dict[str, Array | tuple[float, float, float]] = {}
        for name, numbers in poses.items():
            if self._world.truth(name).pinch().max() > _HELD_N:
                raise UsageError(f"a hand holds '{name}'")
            if len(numbers) == 3:
                x, y, yaw = numbers
                places[name] = (x, y, yaw)
            else:
                places[name] = np.array(numbers, dtype=float).reshape(4, 4)
        put_down(self._world, places)

    def _reply(self, answer: bytes) -> None:
        client = self._client
        if client is None:
            return
        try:
            client.setblocking(True)
            client.sendall(answer)
            client.setblocking(False)
        except OSError:
            self.drop()

    def drop(self) -> None:
        """Close the connection to the client."""
        if self._client is not None:
            self._client.close()
        self._client = None

    def close(self) -> None:
        """Stop listening."""
        self.drop()
        self._listener.close()
