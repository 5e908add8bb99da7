"""Record scripted demonstrations of gym-aloha's TransferCube as HDF5 files in ALOHA's layout.

    python scripts/gym_aloha/record.py --episodes 50 --out outputs/aloha

It makes two folders, which `minidual data merge` joins to a LeRobot dataset (docs/other-suites.md).
Runs in gym-aloha's environment, with h5py.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import h5py
import numpy as np
from cube import RATE_HZ, STEPS_MAX, Array, Observation, Script, TransferCube

FIRST_SEED = 1000
"""Evaluation begins at 0: no start is both shown and tested."""
PARTS = ("a", "b")
_HOLD_STEPS = 25
"""Recorded after the success, in which the hands stay."""
_CAMERA = "top"


def episode(env: TransferCube, seed: int) -> tuple[list[Observation], list[Array], bool]:
    """Return what was seen and done in an episode of the script, and whether it succeeded."""
    seen = [env.reset(seed)]
    script = Script(env)
    actions: list[Array] = []
    last = STEPS_MAX
    succeeded = False
    for k in range(STEPS_MAX):
        action = script.action(k / RATE_HZ)
        observation, success = env.step(action)
        actions.append(action)
        seen.append(observation)
        if success and not succeeded:
            succeeded = True
            last = min(k + _HOLD_STEPS, STEPS_MAX)
        if k >= last:
            break
    return seen[:-1], actions, succeeded


def write(path: Path, seen: list[Observation], actions: list[Array]) -> None:
    """Write an episode; nothing half-written has its name."""
    unfinished = path.with_suffix(".part")
    with h5py.File(unfinished, "w") as file:
        file.attrs["sim"] = True
        file.attrs["fps"] = RATE_HZ
        file["action"] = np.array(actions)
        file["observations/qpos"] = np.array([one.state for one in seen])
        pictures = np.array([one.picture for one in seen])
        file.create_dataset(f"observations/images/{_CAMERA}", data=pictures, compression="gzip")
    unfinished.replace(path)


def main() -> None:
    """Record until so many episodes have succeeded."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    env = TransferCube()
    kept_n = 0
    seed = FIRST_SEED
    while kept_n < options.episodes:
        seen, actions, succeeded = episode(env, seed)
        if succeeded:
            folder = options.out / PARTS[kept_n % len(PARTS)]
            folder.mkdir(parents=True, exist_ok=True)
            write(folder / f"episode_{seed}.hdf5", seen, actions)
            kept_n += 1
        print(f"start {seed}: {'kept' if succeeded else 'failed'}, {kept_n} kept", flush=True)
        seed += 1
    env.close()


if __name__ == "__main__":
    main()
