"""A policy server in a thread of the test process."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from websockets.sync.server import serve

from minidual.policies.messages import pack, unpack

CHUNK = 25
HELLO = {
    "protocol": 1,
    "name": "toy",
    "cameras": {"high": [96, 128]},
    "dim": 16,
    "chunk_size": CHUNK,
    "rate_hz": 50.0,
}


def stay(message: dict[str, Any]) -> dict[str, Any]:
    """Answer with the measured posture, hands open."""
    actions = np.repeat(message["state"][None].astype(float), CHUNK, axis=0)
    actions[:, 14:] = 1.0
    return {"actions": actions}


@contextmanager
def served(
    answer: Callable[[dict[str, Any]], dict[str, Any]] = stay,
    *,
    hello: dict[str, Any] | None = None,
    takes_s: float = 0.0,
) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Serve a policy; yield its address, and the messages that came."""
    messages: list[dict[str, Any]] = []

    def handle(connection: Any) -> None:
        connection.send(pack(HELLO if hello is None else hello))
        for data in connection:
            message = unpack(data)
            messages.append(message)
            time.sleep(takes_s)
            connection.send(pack(answer(message)))

    with serve(handle, "127.0.0.1", 0, max_size=None) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        port = server.socket.getsockname()[1]
        yield f"ws://127.0.0.1:{port}", messages
        server.shutdown()
        thread.join(timeout=10.0)
