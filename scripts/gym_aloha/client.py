"""A client of a policy server (docs/lerobot.md has the messages), without minidual."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np
import numpy.typing as npt

type Array = npt.NDArray[np.float64]
type Picture = npt.NDArray[np.uint8]

STEPS_OF_CHUNK = 25
"""Actions that are run of each chunk, as `minidual deploy` does."""
BLEND_STEPS = 8
"""Actions over which the next chunk replaces the last one."""


class Policy:
    """A policy server, asked as often as its chunks need.

    Args:
        connection: An open WebSocket.
        picture_px: Height and width of the picture.

    Raises:
        SystemExit: The policy reads other pictures, or refuses a message.
    """

    def __init__(self, connection: Any, picture_px: tuple[int, int]) -> None:
        self._connection = connection
        hello = unpack(connection.recv())
        cameras = {name: tuple(size) for name, size in hello["cameras"].items()}
        if list(cameras.values()) != [picture_px]:
            raise SystemExit(f"the policy reads {cameras}; here is one picture of {picture_px}")
        self._camera = next(iter(cameras))
        self._chunk: Array = np.empty((0, 0))
        self._k = 0

    def reset(self) -> None:
        """Begin an episode."""
        self._chunk = np.empty((0, 0))
        self._k = 0

    def act(self, state: Array, picture: Picture) -> Array:
        """Return the next action (n,) for a state (n,) and a picture (height, width, 3)."""
        if self._k == min(STEPS_OF_CHUNK, len(self._chunk)):
            self._ask(state, picture)
        action = self._chunk[self._k]
        self._k += 1
        return action

    def _ask(self, state: Array, picture: Picture) -> None:
        begins = len(self._chunk) == 0
        message = {
            "reset": begins,
            "task": "transfer the cube",
            "state": state.astype(np.float32),
            "images": {self._camera: picture},
        }
        self._connection.send(pack(message))
        answer = unpack(self._connection.recv())
        if "error" in answer:
            raise SystemExit(f"the policy server: {answer['error']}")
        chunk = np.array(answer["actions"], dtype=float)
        if not begins:
            rest = self._chunk[STEPS_OF_CHUNK:][:BLEND_STEPS]
            share = (np.arange(len(rest))[:, None] + 1.0) / (len(rest) + 1.0)
            chunk[: len(rest)] = (1.0 - share) * rest + share * chunk[: len(rest)]
        self._chunk = chunk
        self._k = 0


def pack(message: dict[str, Any]) -> bytes:
    """Return a message as bytes."""
    return msgpack.packb(message, default=_plain)


def unpack(data: bytes | str) -> dict[str, Any]:
    """Return a message."""
    return msgpack.unpackb(data, object_hook=_array)


def _plain(value: np.ndarray) -> dict[str, Any]:
    return {
        "__ndarray__": True,
        "data": np.ascontiguousarray(value).tobytes(),
        "dtype": value.dtype.str,
        "shape": list(value.shape),
    }


def _array(mapping: dict[str, Any]) -> Any:
    if "__ndarray__" not in mapping:
        return mapping
    return np.frombuffer(mapping["data"], mapping["dtype"]).reshape(mapping["shape"])
