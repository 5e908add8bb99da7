"""Serve a checkpoint of train-act or of lerobot-train; docs/lerobot.md has the messages.

Other machines and other robots can ask it:
    python examples/serve_checkpoint.py runs/standard/train-act/checkpoint --port 8000
    minidual try rod_carry --method act --checkpoint ws://127.0.0.1:8000
"""

import argparse
from functools import partial
from pathlib import Path

from websockets.sync.server import ServerConnection, serve

from minidual.errors import MinidualError
from minidual.policies.kinds import ChunkPolicy, load_policy
from minidual.policies.messages import pack, unpack


def hello(policy: ChunkPolicy, name: str) -> dict:
    """Say what the policy reads and gives."""
    return {
        "protocol": 1,
        "name": name,
        "cameras": {camera: list(size) for camera, size in policy.cameras.items()},
        "dim": policy.dim,
        "inputs": dict(policy.inputs),
        "chunk_size": policy.chunk_size,
        "names": list(policy.facts.names) if policy.facts.names else None,
        "rate_hz": policy.facts.rate_hz,
    }


def answer(policy: ChunkPolicy, name: str, connection: ServerConnection) -> None:
    """Describe the policy, then answer each message by a chunk of actions, or by what is wrong."""
    connection.send(pack(hello(policy, name)))
    for data in connection:
        try:
            message = unpack(data)
            if message["reset"]:
                policy.reset()
                policy.instruct(message["task"])
            reply = {"actions": policy.predict(message["images"], message["state"])}
        except (MinidualError, KeyError, ValueError) as error:
            reply = {"error": str(error)}
        connection.send(pack(reply))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--port", type=int, default=8000)
    options = parser.parse_args()
    try:
        handler = partial(answer, load_policy(options.checkpoint), str(options.checkpoint))
    except MinidualError as error:
        parser.error(error.message)
    with serve(handler, "127.0.0.1", options.port, max_size=None, compression=None) as server:
        print(f"serving at ws://127.0.0.1:{options.port}", flush=True)
        server.serve_forever()
