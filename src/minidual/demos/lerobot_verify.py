"""Holding a LeRobot dataset against the recordings it was made of, by a path LeRobot has no part in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from minidual.demos.episode import Episode, read_episode
from minidual.demos.lerobot_mapping import STATE_NAMES, camera_key, state_vector
from minidual.demos.lerobot_reader import (
    ACTION,
    STATE,
    RamDataset,
    camera_keys,
    iterate_frames,
    read_dataset_to_ram,
    read_info,
)
from minidual.errors import DataError

#: Largest mean difference per channel (of 255) that encoding may bring to a picture.
IMAGE_DIFFERENCE_MAX = 6.0


@dataclass(frozen=True)
class DatasetSummary:
    """What a conversion or a verification found.

    Attributes:
        root: Folder of the dataset.
        episodes: Number of episodes.
        frames: Rows, which equal the frames of each video.
        cameras: LeRobot image keys.
        fps: Rate, 1/s.
        image_difference_max: Worst picture's mean |difference| per channel from its recording, of 255.
    """

    root: Path
    episodes: int
    frames: int
    cameras: tuple[str, ...]
    fps: int
    image_difference_max: float


def verify_dataset(root: Path | str, paths: Sequence[Path | str]) -> DatasetSummary:
    """Re-open a dataset without LeRobot and hold it against its recordings.

    Every episode must have as many rows and as many frames in each video as its recording has ticks, the
    same state and action after float32, and pictures that differ by encoding alone.

    Raises:
        DataError: naming the episode and what differs.
    """
    root = Path(root)
    data = read_dataset_to_ram(root, cameras=())
    if len(data.episode_from) != len(paths):
        raise DataError(f"{root} holds {len(data.episode_from)} episodes; {len(paths)} were recorded")
    if data.state_names != STATE_NAMES or data.action_names != STATE_NAMES:
        raise DataError(f"{root} names its state {data.state_names}; it must be {STATE_NAMES}")
    cameras = camera_keys(read_info(root))
    for index, path in enumerate(paths):
        _compare_rows(data, index, read_episode(path, cameras=()))
    worst = max((_compare_pictures(root, data, key, paths) for key in cameras), default=0.0)
    return DatasetSummary(
        root=root, episodes=len(paths), frames=len(data), cameras=cameras, fps=int(data.fps), image_difference_max=worst
    )


def _label(index: int, path: Path | str) -> str:
    return f"episode {index} ({Path(path).name})"


def _compare_rows(data: RamDataset, index: int, episode: Episode) -> None:
    """Hold the state and action of one episode against its recording; raise DataError where they differ."""
    start, stop = int(data.episode_from[index]), int(data.episode_to[index])
    label = _label(index, episode.path or "in memory")
    if stop - start != len(episode):
        raise DataError(f"{label} has {stop - start} rows; {len(episode)} ticks were recorded")
    for name, stored, recorded in (
        (STATE, data.state, state_vector(episode.qpos, episode.gripper)),
        (ACTION, data.action, state_vector(episode.action, episode.action_gripper)),
    ):
        if not np.array_equal(stored[start:stop], recorded):
            error = float(np.max(np.abs(stored[start:stop] - recorded)))
            raise DataError(f"{label}: {name} differs from the recording by {error:.3g}")


def _compare_pictures(root: Path, data: RamDataset, key: str, paths: Sequence[Path | str]) -> float:
    """Return the largest mean difference of a picture of one camera; raise DataError where it is too large.

    One recording is in memory at a time, and one decoded picture.
    """
    camera = key.removeprefix(camera_key(""))
    index, recorded, worst = -1, np.empty(0, np.uint8), 0.0
    for row, picture in iterate_frames(root, key):
        if index != data.episode_index[row]:
            index = int(data.episode_index[row])
            recorded = read_episode(paths[index], cameras=[camera]).images[camera]
        tick = int(data.frame_index[row])
        if picture.shape != recorded.shape[1:]:
            raise DataError(
                f"{_label(index, paths[index])}: camera '{camera}' is {picture.shape}, recorded {recorded.shape[1:]}"
            )
        difference = float(np.mean(np.abs(picture.astype(np.int16) - recorded[tick])))
        if difference > IMAGE_DIFFERENCE_MAX:
            raise DataError(
                f"{_label(index, paths[index])}: camera '{camera}' at tick {tick} differs from the recording by "
                f"{difference:.1f} of 255 on average; the limit is {IMAGE_DIFFERENCE_MAX:g}"
            )
        worst = max(worst, difference)
    return worst
