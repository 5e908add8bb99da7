"""A copy of the emulator's world in the client's process, refreshed after each control step."""

import json
import socket
from collections.abc import Mapping
from typing import Any

import numpy as np

from minidual.config.scene import SceneConfig
from minidual.errors import EnvironmentMissingError, UsageError
from minidual.plant.bodies import ObjectPose
from minidual.plant.franka.twin_messages import (
    TWIN_PORT,
    Kind,
    Message,
    MessageError,
    MessageReader,
    packed,
)
from minidual.plant.protocol import PlantEndedError
from minidual.plant.twin import mirror, state_size
from minidual.plant.world import World
from minidual.robot.pair import Robot

_TIMEOUT_S = 5.0
_OF_CLIENT = ("camera",)
"""Parts of a scene that change nothing in the emulator."""


class EmulatorTwin:
    """Asks the emulator for its state; see `plant.twin.Twin`.

    Args:
        host: Address of the left controller.
        scene: As configured here; the emulator must hold the same.
        robot: The arms.

    Attributes:
        world: The copy.

    Raises:
        EnvironmentMissingError: Nothing answers.
        UsageError: The emulator holds another scene, or other arms.
    """

    def __init__(self, host: str, scene: SceneConfig, robot: Robot) -> None:
        self._host = host
        self._reader = MessageReader()
        try:
            self._socket = socket.create_connection((host, TWIN_PORT), timeout=_TIMEOUT_S)
        except OSError as error:
            raise EnvironmentMissingError(
                f"the emulator at {host} does not show its world (port {TWIN_PORT}): {error}",
                remedy="serve it with this version: minidual plant serve",
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            _check_same(json.loads(self._ask(Kind.SCENE).body), scene, robot)
        except Exception:
            self.close()
            raise
        self.world = World(scene, robot, visuals=True)
        self._state = np.empty(state_size(self.world))
        self.refresh()

    def refresh(self) -> None:
        """Take over the emulator's present state.

        Raises:
            PlantEndedError: The emulator is gone.
        """
        body = self._ask(Kind.STATE).body
        self._state[:] = np.frombuffer(body)
        mirror(self.world, self._state)

    def place(self, poses: Mapping[str, ObjectPose]) -> None:
        """See `Twin`."""
        numbers = {name: np.ravel(pose).tolist() for name, pose in poses.items()}
        answer = self._ask(Kind.PLACE, json.dumps(numbers).encode())
        if answer.kind is Kind.REFUSED:
            raise UsageError(
                f"the emulator does not put the objects down: {answer.body.decode()}",
                remedy="open the hands first",
            )
        self.refresh()

    def close(self) -> None:
        """Close the connection to the emulator."""
        self._socket.close()

    def _ask(self, kind: Kind, body: bytes = b"") -> Message:
        try:
            self._socket.sendall(packed(kind, body))
            while True:
                data = self._socket.recv(1 << 16)
                if not data:
                    break
                messages = self._reader.feed(data)
                if messages:
                    return messages[0]
        except (OSError, MessageError) as error:
            raise PlantEndedError(f"the emulator at {self._host} shows nothing: {error}") from error
        raise PlantEndedError(f"the emulator at {self._host} has ended")


def _check_same(held: dict[str, Any], scene: SceneConfig, robot: Robot) -> None:
    """Raise UsageError if the emulator holds another scene, or other arms."""
    if held["robot"] != robot.name:
        raise UsageError(
            f"the emulator's arms are '{held['robot']}', the configured ones '{robot.name}'",
            remedy="serve it with the same --set robot.arm=...",
        )
    different = _difference(held["scene"], scene.model_dump(mode="json"))
    if different:
        raise UsageError(
            f"the emulator holds another scene: {different}",
            remedy="serve it with the same --set and --profile, such as "
            "minidual plant serve --set task=NAME",
        )


def _difference(held: Any, configured: Any, path: str = "scene") -> str:
    """Return the first value of a scene (JSON types) that differs, or an empty string."""
    if isinstance(held, dict) and isinstance(configured, dict):
        for name in sorted({*held, *configured} - set(_OF_CLIENT)):
            below = _difference(held.get(name), configured.get(name), f"{path}.{name}")
            if below:
                return below
        return ""
    return "" if held == configured else f"{path} is {held} there and {configured} here"
