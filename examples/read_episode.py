"""Open a recorded episode, print what it holds and measures, and plot its joints.

python examples/read_episode.py runs/standard/teleop-record/episodes/episode_000000.hdf5

Without a file it records an episode first.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from minidual import Episode, measure_episode, open_episode, record_episodes


def describe(episode: Episode) -> None:
    """Print the content and the measures of an episode."""
    meta = episode.meta
    print(f"{meta.task} {'success' if meta.success else 'failure'}, {meta.fps:g} Hz")
    print(f"joints {episode.qpos.shape} [rad], actions {episode.action.shape} [rad]")
    for camera, frames in episode.images.items():
        print(f"camera '{camera}' {frames.shape}, mean brightness {frames.mean():.0f} of 255")
    for name, value in measure_episode(episode)._asdict().items():
        print(f"{name} {value:.4g}")
    # action[t] is the target that leads to the joints at t + 1.
    error_rad = np.abs(episode.action[:-1] - episode.qpos[1:]).max(axis=0)
    print(f"joints follow their targets within {error_rad.max():.3f} rad")


def plot(episode: Episode, path: Path) -> None:
    """Draw joints and openings over time."""
    time_s = episode.timestamps - episode.timestamps[0]
    figure, (joints, grippers) = plt.subplots(2, 1, sharex=True, figsize=(8, 6))
    joints.plot(time_s, episode.qpos)
    joints.set_ylabel("joints [rad]")
    grippers.plot(time_s, episode.gripper)
    grippers.set(xlabel="time [s]", ylabel="openings (0 to 1)")
    figure.savefig(path)
    print(path)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("episode", nargs="?", type=Path)
    recorded: Path | None = parser.parse_args().episode
    opened = open_episode(recorded or record_episodes("data/example")[0])
    describe(opened)
    plot(opened, Path("episode.png"))
