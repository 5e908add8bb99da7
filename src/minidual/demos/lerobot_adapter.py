"""Convert HDF5 episodes to LeRobot v3; docs/data.md has the keys.

Videos are 4:4:4 at crf 12: the usual 4:2:0 at crf 30 loses the colour of a rod two pixels wide.
"""

import itertools
import json
import logging
import os
import threading
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

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
from minidual.demos.lerobot_reader import ACTION, STATE, LeRobotTables, camera_key, read_dataset
from minidual.errors import DataError, UsageError
from minidual.robot.pair import Robot

SOURCES_FILE = "meta/minidual_sources.json"
"""Lists the recordings of a dataset."""
_VIDEO_FILE_MB = 4  # an episode is added by writing its whole file again
IMAGE_DIFFERENCE_MAX = 6.0
"""Limit of an image's mean difference to the recorded one, of 255."""
_SHORTCUTS: Any = (
    (compute_stats, "auto_downsample_height_width", lambda picture: picture[:, 2::4, 2::4]),
    (dataset_writer, "embed_images", lambda table: table),
)
"""Of LeRobot: statistics of pictures (3, H, W) from every fourth row and column, and tables, which hold no pictures, as
they are. A demonstration of 405 ticks takes 0.6 s of processor time instead of 1.2.
"""


def state_names(robot: Robot) -> tuple[str, ...]:
    """Return joint names, then gripper names."""
    return (*robot.joint_names, *(f"{side}_gripper" for side in robot.sides))


def convert(paths: Iterable[Path], out_dir: Path, robot: Robot) -> LeRobotTables:
    """Make, verify and return a dataset; a failed conversion leaves none.

    `paths` are validated episodes of equal format, each taken when the one before is written.

    Raises:
        UsageError: No episodes, or `out_dir` exists.
        DataError: Inconsistent episodes, or failed verification.
    """
    if (first := next(paths := iter(paths), None)) is None:
        raise UsageError("no episodes to convert", remedy="record some: minidual teleop-record")
    if out_dir.exists():
        raise UsageError(f"{out_dir} exists already", remedy="remove it or choose another folder")
    durable.make_folder(out_dir.parent)
    durable.remove_stale(out_dir.parent.glob(f".{out_dir.name}.*.partial"))
    try:
        with durable.replacing(out_dir) as partial:
            verify_dataset(
                partial,
                _write_dataset(partial, out_dir.name, first, paths, robot),
                robot,
            )
    except OSError as error:
        raise durable.unwritten(
            error,
            out_dir,
            "check the disk or choose another folder",
        ) from error
    return read_dataset(out_dir)


def _write_dataset(
    root: Path,
    name: str,
    first: Path,
    others: Iterable[Path],
    robot: Robot,
) -> list[Path]:
    names = state_names(robot)
    vector = {"dtype": "float32", "shape": (len(names),), "names": list(names)}
    features: dict[str, dict[str, Any]] = {STATE: vector, ACTION: vector}
    given = read_episode(first)
    shapes = {camera: frames.shape[1:] for camera, frames in given.images.items()}
    for camera, shape in shapes.items():
        features[camera_key(camera)] = {
            "dtype": "video",
            "shape": shape,
            "names": ["height", "width", "channels"],
        }
    records = list[dict[str, Any]]()
    written = list[Path]()
    with ExitStack() as stack:
        # Keep encoder reports and progress bars off stderr.
        av.logging.set_libav_level(av.logging.ERROR)
        stack.enter_context(SuppressProgressBars())
        # LeRobot reports a video that it cannot end in time, and goes on without it.
        stack.callback(video_utils.logger.removeFilter, _raise_report)
        video_utils.logger.addFilter(_raise_report)
        for module, member, instead in _SHORTCUTS:
            stack.callback(setattr, module, member, getattr(module, member))
            setattr(module, member, instead)
        dataset = LeRobotDataset.create(
            repo_id=f"local/{name}",
            fps=int(given.meta.fps),
            features=features,
            root=root,
            robot_type=f"dual_{robot.arm.name}",
            use_videos=True,
            video_backend="pyav",
            rgb_encoder=RGBEncoderConfig(
                vcodec="h264",
                preset="veryfast",
                pix_fmt="yuv444p",
                crf=12,
            ),
            streaming_encoding=True,
            encoder_queue_maxsize=0,  # without bound: a full queue drops pictures with only a warning
            video_files_size_in_mb=_VIDEO_FILE_MB,
        )
        stack.callback(dataset.finalize)
        for path in itertools.chain([first], others):
            written.append(path)
            episode = read_episode(path, cameras=tuple(shapes))
            if episode.meta.fps != dataset.fps:
                raise DataError(
                    f"{path} runs at {episode.meta.fps:g} Hz, the dataset at {dataset.fps} Hz (whole, one)",
                )
            for camera, shape in shapes.items():
                if episode.images[camera].shape[1:] != shape:
                    raise DataError(
                        f"{path}: camera '{camera}' is {episode.images[camera].shape[1:]}, not {shape}",
                    )
            state, action = _vectors(episode)
            try:
                for k in range(len(episode)):
                    images = {
                        camera_key(camera): frames[k] for camera, frames in episode.images.items()
                    }
                    dataset.add_frame(
                        {STATE: state[k], ACTION: action[k], "task": episode.meta.task, **images},
                    )
                dataset.save_episode(parallel_encoding=False)
            except RuntimeError as error:  # from an encoder's thread
                raise OSError(f"{error}") from error
            meta = episode.meta
            facts = {
                "file": path.name,
                "seed": meta.seed,
                "ticks": len(episode),
                "success": meta.success,
            }
            records.append({**facts, "extra": dict(meta.extra)})
    text = json.dumps({"episodes": records}, indent=1, sort_keys=True)
    (root / SOURCES_FILE).write_text(text + "\n", encoding="utf-8")
    return written


def _raise_report(record: logging.LogRecord) -> bool:
    if threading.current_thread() is threading.main_thread():
        raise OSError(record.getMessage())
    return False  # an encoder's thread, which raises it again here


def _vectors(episode: Episode) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return state and action, (T, n + 2)."""
    state = (episode.qpos, episode.gripper)
    action = (episode.action, episode.action_gripper)
    return np.concatenate(state, axis=1).astype(np.float32), np.concatenate(action, axis=1).astype(
        np.float32,
    )


def verify_dataset(root: Path, paths: Sequence[Path], robot: Robot) -> float:
    """Compare a dataset, read without LeRobot, with its recordings; return the largest image difference.

    Raises:
        DataError: Unequal lengths or float32 values, or images beyond the limit.
    """
    data = read_dataset(root)
    if len(data.starts) != len(paths):
        raise DataError(f"{root} holds {len(data.starts)} episodes; {len(paths)} were recorded")
    if data.names != state_names(robot):
        raise DataError(f"{root} names its state {data.names}; it must be {state_names(robot)}")
    for index, (path, start, stop) in enumerate(zip(paths, data.starts, data.stops, strict=True)):
        episode = read_episode(path, cameras=())
        label = f"episode {index} ({path.name})"
        if stop - start != len(episode):
            raise DataError(f"{label} has {stop - start} rows; {len(episode)} ticks were recorded")
        for key, stored, recorded in zip(
            (STATE, ACTION),
            (data.state, data.action),
            _vectors(episode),
            strict=True,
        ):
            if not np.array_equal(stored[start:stop], recorded):
                error = float(np.max(np.abs(stored[start:stop] - recorded)))
                raise DataError(f"{label}: {key} differs from the recording by {error:.3g}")
    worst = 0.0
    pictures = np.empty(0, np.uint8)
    for camera in data.cameras:
        for row, image in data.frames(camera):
            path = paths[data.episode_index[row]]
            tick = int(data.frame_index[row])
            label = f"episode {data.episode_index[row]} ({path.name}): camera '{camera}'"
            if tick == 0:
                pictures = read_episode(path, cameras=(camera,)).images[camera]
            if image.shape != pictures.shape[1:]:
                raise DataError(f"{label} is {image.shape}, recorded {pictures.shape[1:]}")
            difference = float(np.mean(np.abs(image.astype(np.int16) - pictures[tick])))
            if difference > IMAGE_DIFFERENCE_MAX:
                off = f"differs from the recording by {difference:.1f} of 255 on average"
                raise DataError(
                    f"{label} at tick {tick} {off}; the limit is {IMAGE_DIFFERENCE_MAX:g}",
                )
            worst = max(worst, difference)
    return worst
