"""Convert HDF5 episodes to LeRobot v3; docs/data.md has the keys.

Videos are 4:4:4 at crf 12: the usual 4:2:0 at crf 30 loses the colour of a rod two pixels wide.
"""

import itertools
import json
import logging
import os
import threading
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

os.environ.setdefault("HF_HUB_OFFLINE", "1")  # LeRobot reads it on import

import av.logging
import numpy as np
from lerobot.configs.video import RGBEncoderConfig
from lerobot.datasets import compute_stats, dataset_writer, video_utils
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.utils.utils import SuppressProgressBars
from numpy.typing import NDArray

from minidual import durable
from minidual.demos.episode import Episode, read_episode
from minidual.demos.lerobot_features import SOURCES_FILE, signal_key, state_names
from minidual.demos.lerobot_reader import ACTION, STATE, LeRobotTables, camera_key, read_dataset
from minidual.errors import DataError, UsageError
from minidual.robot.pair import Array, Robot

IMAGE_DIFFERENCE_MAX = 6.0
"""Limit of an image's mean difference to the recorded one, of 255."""
VIDEO_ENCODING = RGBEncoderConfig(
    vcodec="h264",
    preset="veryfast",
    pix_fmt="yuv444p",
    crf=12,
)
_VIDEO_FILE_MB = 4
"""Size at which the next video file begins: an episode is added by writing its whole file again."""


class _Shortcut(NamedTuple):
    """A function that replaces one of LeRobot's."""

    module: ModuleType
    name: str
    replacement: Callable[[Any], Any]


def _every_fourth_pixel(picture: Any) -> Any:
    """Return a picture (3, H, W) with every fourth row and column, for its statistics."""
    return picture[:, 2::4, 2::4]


def _unchanged(table: Any) -> Any:
    """Return a table without pictures, unchanged."""
    return table


_SHORTCUTS = (
    _Shortcut(compute_stats, "auto_downsample_height_width", _every_fourth_pixel),
    _Shortcut(dataset_writer, "embed_images", _unchanged),
)
"""With them a demonstration of 405 ticks takes 0.6 s of processor time instead of 1.2."""


def convert(paths: Iterable[Path], out_dir: Path, robot: Robot) -> LeRobotTables:
    """Make, verify and return a dataset; a failed conversion leaves none.

    `paths` are validated episodes of equal format, each taken when the one before is written.

    Raises:
        UsageError: No episodes, or `out_dir` exists.
        DataError: Inconsistent episodes, or failed verification.
    """
    paths = iter(paths)
    first = next(paths, None)
    if first is None:
        raise UsageError("no episodes to convert", remedy="record some: minidual teleop-record")
    if out_dir.exists():
        raise UsageError(f"{out_dir} exists already", remedy="remove it or choose another folder")
    durable.make_folder(out_dir.parent)
    durable.remove_stale(out_dir.parent.glob(f".{out_dir.name}.*.partial"))
    try:
        with durable.replacing(out_dir) as partial:
            all_paths = itertools.chain([first], paths)
            written = _write_dataset(partial, out_dir.name, first, all_paths, robot)
            verify_dataset(partial, written, robot)
    except OSError as error:
        remedy = "check the disk or choose another folder"
        raise durable.unwritten(error, out_dir, remedy) from error
    return read_dataset(out_dir)


def _write_dataset(
    root: Path,
    name: str,
    sample: Path,
    paths: Iterable[Path],
    robot: Robot,
) -> list[Path]:
    """Write the episodes in the format of `sample`; return their paths."""
    sample_episode = read_episode(sample)
    shapes = {camera: frames.shape[1:] for camera, frames in sample_episode.images.items()}
    sizes = {name: values[0].size for name, values in sample_episode.signals.items()}
    records: list[dict[str, Any]] = []
    written: list[Path] = []
    with ExitStack() as stack:
        stack.enter_context(quiet_and_fast())
        fps = int(sample_episode.meta.fps)
        dataset = _create_dataset(root, name, fps, shapes, robot, sizes)
        stack.callback(dataset.finalize)
        for path in paths:
            written.append(path)
            episode = read_episode(path, cameras=tuple(shapes))
            _check_format(path, episode, dataset.fps, shapes)
            _check_signals(path, episode, sizes)
            _add_episode(dataset, episode)
            records.append(_source_record(path, episode))
    text = json.dumps({"episodes": records}, indent=1, sort_keys=True)
    (root / SOURCES_FILE).write_text(text + "\n", encoding="utf-8")
    return written


@contextmanager
def quiet_and_fast() -> Generator[None]:
    """Change LeRobot for a while: no reports on stderr, lost videos as errors, `_SHORTCUTS`."""
    with ExitStack() as stack:
        av.logging.set_libav_level(av.logging.ERROR)
        stack.enter_context(SuppressProgressBars())
        # LeRobot reports a video that it cannot end in time, and goes on without it.
        video_utils.logger.addFilter(_raise_report)
        stack.callback(video_utils.logger.removeFilter, _raise_report)
        for shortcut in _SHORTCUTS:
            original = getattr(shortcut.module, shortcut.name)
            setattr(shortcut.module, shortcut.name, shortcut.replacement)
            stack.callback(setattr, shortcut.module, shortcut.name, original)
        yield


def _create_dataset(
    root: Path,
    name: str,
    fps: int,
    shapes: dict[str, tuple[int, ...]],
    robot: Robot,
    signal_sizes: dict[str, int],
) -> LeRobotDataset:
    names = state_names(robot)
    vector = {"dtype": "float32", "shape": (len(names),), "names": list(names)}
    features: dict[str, dict[str, Any]] = {STATE: vector, ACTION: vector}
    for signal, size in signal_sizes.items():
        features[signal_key(signal)] = {
            "dtype": "float32",
            "shape": (size,),
            "names": [f"{signal}_{k}" for k in range(size)],
        }
    for camera, shape in shapes.items():
        features[camera_key(camera)] = {
            "dtype": "video",
            "shape": shape,
            "names": ["height", "width", "channels"],
        }
    return LeRobotDataset.create(
        repo_id=f"local/{name}",
        fps=fps,
        features=features,
        root=root,
        robot_type=f"dual_{robot.name}",
        use_videos=True,
        video_backend="pyav",
        rgb_encoder=VIDEO_ENCODING,
        streaming_encoding=True,
        encoder_queue_maxsize=0,  # without bound: a full queue drops pictures with only a warning
        video_files_size_in_mb=_VIDEO_FILE_MB,
    )


def _check_format(
    path: Path,
    episode: Episode,
    fps: int,
    shapes: dict[str, tuple[int, ...]],
) -> None:
    """Raise DataError for another rate or other pictures than the dataset's."""
    if episode.meta.fps != fps:
        raise DataError(
            f"{path} runs at {episode.meta.fps:g} Hz, the dataset at {fps} Hz; "
            "all episodes need one rate, a whole number",
        )
    for camera, shape in shapes.items():
        recorded = episode.images[camera].shape[1:]
        if recorded != shape:
            raise DataError(f"{path}: camera '{camera}' is {recorded}, not {shape}")


def _check_signals(path: Path, episode: Episode, sizes: dict[str, int]) -> None:
    """Raise DataError for other signals than the dataset's."""
    recorded = {name: values[0].size for name, values in episode.signals.items()}
    if recorded != sizes:
        raise DataError(
            f"{path} holds the signals {', '.join(recorded) or 'none'}, the dataset "
            f"{', '.join(sizes) or 'none'}; all episodes need the same",
        )


def _add_episode(dataset: LeRobotDataset, episode: Episode) -> None:
    state = _with_grippers(episode.qpos, episode.gripper)
    action = _with_grippers(episode.action, episode.action_gripper)
    try:
        for tick in range(len(episode)):
            images = {camera_key(camera): frames[tick] for camera, frames in episode.images.items()}
            signals = {
                signal_key(name): values[tick].ravel().astype(np.float32)
                for name, values in episode.signals.items()
            }
            dataset.add_frame(
                {
                    STATE: state[tick],
                    ACTION: action[tick],
                    "task": episode.meta.task,
                    **images,
                    **signals,
                },
            )
        dataset.save_episode(parallel_encoding=False)
    except RuntimeError as error:  # from an encoder's thread
        raise OSError(f"{error}") from error


def _source_record(path: Path, episode: Episode) -> dict[str, Any]:
    return {
        "file": path.name,
        "seed": episode.meta.seed,
        "ticks": len(episode),
        "success": episode.meta.success,
        "extra": dict(episode.meta.extra),
    }


def _raise_report(record: logging.LogRecord) -> bool:
    if threading.current_thread() is threading.main_thread():
        raise OSError(record.getMessage())
    return False  # an encoder's thread, which raises it again here


def _with_grippers(joints: Array, openings: Array) -> NDArray[np.float32]:
    """Return joints (T, n) and openings (T, 2) as (T, n + 2)."""
    return np.concatenate([joints, openings], axis=1).astype(np.float32)


def verify_dataset(root: Path, paths: Sequence[Path], robot: Robot) -> float:
    """Compare a dataset, read without LeRobot, with its recordings.

    Returns:
        The largest mean difference of an image to the recorded one, of 255.

    Raises:
        DataError: Unequal lengths or float32 values, or images beyond the limit.
    """
    data = read_dataset(root)
    if len(data.starts) != len(paths):
        raise DataError(f"{root} holds {len(data.starts)} episodes; {len(paths)} were recorded")
    for word, names in (("state", data.names), ("action", data.action_names)):
        if names != state_names(robot):
            raise DataError(f"{root} names its {word} {names}; it must be {state_names(robot)}")
    for index, path in enumerate(paths):
        _verify_rows(data, index, path)
    differences = [_verify_camera(data, camera, paths) for camera in data.cameras]
    return max(differences, default=0.0)


def _verify_rows(data: LeRobotTables, index: int, path: Path) -> None:
    """Raise DataError unless states and actions of an episode are those recorded."""
    episode = read_episode(path, cameras=())
    rows = slice(data.starts[index], data.stops[index])
    rows_n = data.stops[index] - data.starts[index]
    label = f"episode {index} ({path.name})"
    if rows_n != len(episode):
        raise DataError(f"{label} has {rows_n} rows; {len(episode)} ticks were recorded")
    state = _with_grippers(episode.qpos, episode.gripper)
    action = _with_grippers(episode.action, episode.action_gripper)
    for key, stored, recorded in (
        (STATE, data.state[rows], state),
        (ACTION, data.action[rows], action),
    ):
        if not np.array_equal(stored, recorded):
            error = float(np.max(np.abs(stored - recorded)))
            raise DataError(f"{label}: {key} differs from the recording by {error:.3g}")


def _verify_camera(data: LeRobotTables, camera: str, paths: Sequence[Path]) -> float:
    """Return the largest difference of a camera's images; DataError if it is over the limit."""
    worst = 0.0
    recorded = np.empty(0, np.uint8)
    for row, image in data.frames(camera):
        episode_index = data.episode_index[row]
        tick = int(data.frame_index[row])
        path = paths[episode_index]
        label = f"episode {episode_index} ({path.name}): camera '{camera}'"
        if tick == 0:
            recorded = read_episode(path, cameras=(camera,)).images[camera]
        if image.shape != recorded.shape[1:]:
            raise DataError(f"{label} is {image.shape}, recorded {recorded.shape[1:]}")
        difference = float(np.mean(np.abs(image.astype(np.int16) - recorded[tick])))
        if difference > IMAGE_DIFFERENCE_MAX:
            raise DataError(
                f"{label} at tick {tick} differs from the recording by {difference:.1f} of 255 "
                f"on average; the limit is {IMAGE_DIFFERENCE_MAX:g}",
            )
        worst = max(worst, difference)
    return worst
