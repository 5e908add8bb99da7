"""Serve a policy to minidual: docs/lerobot.md has the messages.

    pip install 'minidual[server]'
    python examples/policy_server.py --port 8000
    minidual try rod_carry --method act --checkpoint ws://127.0.0.1:8000

Replace `plan` by a network: it gets what cameras and joints measure, and returns a chunk of actions.
"""

import argparse

import numpy as np
from websockets.sync.server import ServerConnection, serve

from minidual.policies.messages import pack, unpack

JOINTS_N = 14
CHUNK = 25
HELLO = {
    "protocol": 1,
    "name": "nod",
    "cameras": {"high": [96, 128]},
    "dim": JOINTS_N + 2,
    "chunk_size": CHUNK,
    "rate_hz": 50.0,
    "units": "rad",
}


def plan(message: dict, start: np.ndarray) -> np.ndarray:
    """Return actions (CHUNK, 16): move both wrists a little towards the brighter half of the picture."""
    picture = message["images"]["high"].astype(float)
    brighter = np.sign(picture[:, :64].mean() - picture[:, 64:].mean())
    actions = np.repeat(message["state"][None], CHUNK, axis=0)
    actions[:, [6, 13]] = start[[6, 13]] + 0.1 * brighter
    actions[:, JOINTS_N:] = 1.0
    return actions


def answer(connection: ServerConnection) -> None:
    """Say what the policy is, then answer each message."""
    connection.send(pack(HELLO))
    start = np.zeros(JOINTS_N + 2)
    for data in connection:
        message = unpack(data)
        if message["reset"]:
            start = message["state"]
        connection.send(pack({"actions": plan(message, start)}))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--port", type=int, default=8000)
    port = parser.parse_args().port
    with serve(answer, "127.0.0.1", port, max_size=None, compression=None) as server:
        print(f"serving at ws://127.0.0.1:{port}", flush=True)
        server.serve_forever()
