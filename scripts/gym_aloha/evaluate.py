"""Try a policy behind a socket on gym-aloha's TransferCube, judged by gym-aloha's own success test.

    python scripts/gym_aloha/evaluate.py --address ws://127.0.0.1:8000 --episodes 200

examples/serve_checkpoint.py serves a checkpoint. Runs in gym-aloha's environment, with msgpack and
websockets; docs/lerobot.md has the messages.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from client import Policy
from cube import HEIGHT_PX, STEPS_MAX, WIDTH_PX, TransferCube
from websockets.sync.client import connect

_Z = 1.96


def run(env: TransferCube, policy: Policy, seed: int) -> int | None:
    """Return the step of an episode at which it succeeds, or None."""
    seen = env.reset(seed)
    policy.reset()
    for k in range(STEPS_MAX):
        seen, success = env.step(policy.act(seen.state, seen.picture))
        if success:
            return k + 1
    return None


def wilson(successes_n: int, trials_n: int) -> tuple[float, float]:
    """Return the 95 % Wilson interval of a rate."""
    rate = successes_n / trials_n
    scale = 1.0 + _Z**2 / trials_n
    middle = (rate + _Z**2 / (2 * trials_n)) / scale
    half = _Z * np.sqrt(rate * (1.0 - rate) / trials_n + _Z**2 / (4 * trials_n**2)) / scale
    return float(middle - half), float(middle + half)


def main() -> None:
    """Run the episodes, print each, and the share of successes; go on after an interruption."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--address", default="ws://127.0.0.1:8000")
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--out", type=Path, help="a file to which each episode is appended")
    options = parser.parse_args()
    ended: list[int | None] = []
    if options.out is not None and options.out.exists():
        lines = options.out.read_text(encoding="utf-8").splitlines()
        ended = [json.loads(line)["success_step"] for line in lines]
    env = TransferCube()
    with connect(options.address, max_size=None, compression=None) as connection:
        policy = Policy(connection, (HEIGHT_PX, WIDTH_PX))
        for seed in range(len(ended), options.episodes):
            ended.append(run(env, policy, seed))
            if options.out is not None:
                with options.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"seed": seed, "success_step": ended[-1]}) + "\n")
            print(f"start {seed}: {'failure' if ended[-1] is None else 'success'}", flush=True)
    env.close()
    successes_n = sum(step is not None for step in ended)
    low, high = wilson(successes_n, len(ended))
    print(f"{successes_n} of {len(ended)} ({100 * low:.0f}-{100 * high:.0f} %)")


if __name__ == "__main__":
    main()
