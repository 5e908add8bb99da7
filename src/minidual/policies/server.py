"""A policy behind a socket: on another machine or in another environment (docs/lerobot.md)."""

import atexit
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minidual import durable
from minidual.errors import DataError, EnvironmentMissingError, UsageError
from minidual.policies.chunk_policy import ChunkPolicy, Image
from minidual.policies.facts import PolicyFacts
from minidual.policies.kinds import PolicyKind, Training, TrainResult
from minidual.policies.messages import hello_of, pack, unpack

_OPEN_TIMEOUT_S = 10.0
_ANSWER_TIMEOUT_S = 60.0


class ServerPolicy(ChunkPolicy):
    """Sends pictures and joint readings, and gets a chunk of actions.

    The simulation stands still while it waits; `answer_s` says how long that was.

    Raises:
        EnvironmentMissingError: Nobody answers at the address, or a library is missing.
        DataError: What answers is no policy server.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self._socket = _connected(address)
        atexit.register(self.close)
        hello = hello_of(self._received())
        self.cameras = dict(hello.cameras)
        self.chunk_size = hello.chunk_size
        self.dim = hello.dim
        self.inputs = dict(hello.inputs)
        self.name = hello.name
        self.facts = PolicyFacts(names=hello.names, rate_hz=hello.rate_hz, units=hello.units)
        self._task = ""
        self._is_new = True

    def reset(self) -> None:
        """Tell the server with the next message that an episode begins."""
        self._is_new = True

    def instruct(self, task: str) -> None:
        """Send an instruction with every message from now on."""
        self._task = task

    def predict(
        self,
        images: Mapping[str, Image],
        state: NDArray[np.float32],
    ) -> NDArray[np.float64]:
        """Return the server's chunk."""
        message: dict[str, Any] = {
            "reset": self._is_new,
            "task": self._task,
            "state": np.asarray(state, dtype=np.float32),
            "images": dict(images),
        }
        began_s = time.perf_counter()
        self._send(pack(message))
        answer = unpack(self._received())
        self.answer_s = time.perf_counter() - began_s
        self._is_new = False
        if "error" in answer:
            raise DataError(f"the policy server {self.address} says: {answer['error']}")
        actions = answer.get("actions")
        expected = (self.chunk_size, self.dim)
        if not isinstance(actions, np.ndarray) or actions.shape != expected:
            shape = getattr(actions, "shape", type(actions).__name__)
            raise DataError(
                f"the policy server {self.address} answers 'actions' {shape};"
                f" its first message said {expected}",
            )
        return actions.astype(np.float64)

    def close(self) -> None:
        """Hang up."""
        self._socket.close()

    def _send(self, data: bytes) -> None:
        try:
            self._socket.send(data)
        except Exception as error:  # the library raises various types
            raise self._gone(error) from error

    def _received(self) -> bytes:
        try:
            data = self._socket.recv(timeout=_ANSWER_TIMEOUT_S)
        except TimeoutError as error:
            raise EnvironmentMissingError(
                f"the policy server {self.address} has not answered for {_ANSWER_TIMEOUT_S:g} s",
                remedy="look at its own messages",
            ) from error
        except Exception as error:  # as above
            raise self._gone(error) from error
        if isinstance(data, str):
            raise DataError(
                f"the policy server {self.address} sends text, not msgpack: '{data[:200]}'",
            )
        return data

    def _gone(self, error: Exception) -> EnvironmentMissingError:
        return EnvironmentMissingError(
            f"the policy server {self.address} has hung up: {error}",
            remedy="look at its own messages, and start it again",
        )


def _connected(address: str) -> Any:
    try:
        from websockets.sync.client import connect
    except ModuleNotFoundError as error:
        raise EnvironmentMissingError(
            "a policy server needs the library 'websockets', which is not installed",
            remedy="pip install 'minidual[server]'",
        ) from error
    try:
        return connect(address, open_timeout=_OPEN_TIMEOUT_S, max_size=None, compression=None)
    except Exception as error:  # OSError, and the library's own
        raise EnvironmentMissingError(
            f"no policy server answers at {address}: {error}",
            remedy="start it, for example python examples/policy_server.py",
        ) from error


class ServerKind(PolicyKind):
    """Policies that other programs serve."""

    def train(self, job: Training, folder: Path) -> TrainResult:
        """Refuse: a served policy is trained where it is served.

        Raises:
            UsageError: Always.
        """
        raise UsageError("a policy server cannot be trained from here")

    def load(self, folder: Path, device: str, threads: int | None) -> ChunkPolicy:
        """Connect; see `ServerPolicy`."""
        return ServerPolicy(str(durable.read_json(folder / "config.json")["address"]))


SERVER = ServerKind()
