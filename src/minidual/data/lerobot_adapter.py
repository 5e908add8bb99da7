"""From recorded HDF5 episodes to a LeRobot v3 dataset. No other code knows both schemas.

=============================  ==========================================================================
LeRobot key                    from
=============================  ==========================================================================
``observation.state``          (16,) float32: ``observations/qpos`` (14), then ``observations/gripper`` (2)
``action``                     (16,) float32: ``action`` (14), then ``action_gripper`` (2)
``observation.images.cam_*``   ``observations/images/*`` as h264 video
``timestamp``                  LeRobot's own: tick / fps
=============================  ==========================================================================

Videos keep full colour resolution (4:4:4) at crf 12: with the usual 4:2:0 at crf 30 a rod two pixels wide
loses its colour, and the policy would train on other pictures than it meets (measured on rendered 96x128
frames, mean difference per channel: 7.7 of 255 against 2.1; 2.3 kB a frame).
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minidual.data import durable, schema
from minidual.data.episode import Episode, read_episode, read_meta
from minidual.data.lerobot_reader import ACTION, IMAGE_PREFIX, STATE, RamDataset, read_dataset_to_ram
from minidual.errors import DataError, UsageError
from minidual.robot.constants import JOINT_NAMES

STATE_N = schema.JOINTS_N + schema.GRIPPERS_N

#: Names of the 16 values of state and action, in order.
STATE_NAMES: tuple[str, ...] = (
    *JOINT_NAMES,
    "left_gripper",
    "right_gripper",
)

#: Where a dataset says which recordings it was made of.
SOURCES_FILE = "meta/minidual_sources.json"

VIDEO_CODEC = "h264"
VIDEO_PRESET = "veryfast"
VIDEO_PIXELS = "yuv444p"
VIDEO_CRF = 12

#: Largest mean difference per channel (of 255) that encoding may bring to an episode's pictures.
IMAGE_DIFFERENCE_MAX = 6.0

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class DatasetSummary:
    """What a conversion or a verification found.

    Attributes:
        root: Folder of the dataset.
        episodes: Number of episodes.
        frames: Rows, which equal the frames of each video.
        cameras: LeRobot image keys.
        fps: Rate, 1/s.
        state_error_max: Largest |difference| of state and action from the recordings after float32.
        image_difference_mean: Worst episode's and camera's mean |difference| per channel, of 255.
    """

    root: Path
    episodes: int
    frames: int
    cameras: tuple[str, ...]
    fps: int
    state_error_max: float
    image_difference_mean: float


def camera_key(camera: str) -> str:
    """Return the LeRobot key of a camera: ``high`` gives ``observation.images.cam_high``."""
    return f"{IMAGE_PREFIX}cam_{camera}"


def state_vector(qpos: NDArray[np.floating], gripper: NDArray[np.floating]) -> NDArray[np.float32]:
    """Join joints (..., 14) and grippers (..., 2) into LeRobot's state or action (..., 16) float32."""
    return np.concatenate([qpos, gripper], axis=-1).astype(np.float32)


def split_vector(vector: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Part LeRobot's state or action (..., 16) into joints (..., 14) and grippers (..., 2)."""
    if vector.shape[-1] != STATE_N:
        raise DataError(f"state or action has {vector.shape[-1]} values; it must have {STATE_N}")
    return vector[..., : schema.JOINTS_N], vector[..., schema.JOINTS_N :]


def convert(
    paths: Sequence[Path | str],
    out_dir: Path | str,
    *,
    cameras: Sequence[str] | None = None,
    task: str | None = None,
    fps: int | None = None,
    overwrite: bool = False,
    crf: int = VIDEO_CRF,
    progress: Progress | None = None,
) -> DatasetSummary:
    """Make a LeRobot dataset of recordings, verify it, and give it its name.

    The work is done under a temporary name beside `out_dir`; a killed or failed conversion leaves no
    dataset. Recordings are taken in the given order; choose and validate them before.

    Args:
        paths: HDF5 episodes; all of the same rate, cameras and picture sizes.
        out_dir: Folder to make.
        cameras: Which cameras to take, by recorded name; all of the first episode's when None.
        task: The task in words; each recording's own when None.
        fps: The rate the dataset must have; the recordings' own when None.
        overwrite: Replace an existing dataset.
        crf: h264 quality, 0 to 51, less is better.
        progress: Called with (episodes done, episodes in all).

    Raises:
        UsageError: no episodes, `out_dir` exists, or `crf` out of range.
        DataError: episodes disagree or are corrupt, the disk refuses, or verification fails.
    """
    out_dir = Path(out_dir)
    sources = [Path(path) for path in paths]
    if not sources:
        raise UsageError("no episodes to convert", remedy="record some: minidual teleop-record")
    if not 0 <= crf <= 51:
        raise UsageError(f"crf is {crf}; it must lie between 0 and 51")
    if out_dir.exists() and not overwrite:
        raise UsageError(
            f"{out_dir} exists already", remedy="remove it, choose another folder, or overwrite it"
        )
    layout = _common_layout(sources, cameras, fps)
    durable.make_folder(out_dir.parent)
    partial = durable.partial_path(out_dir)
    durable.remove(partial)
    durable.remove_stale(out_dir)
    try:
        _write_dataset(partial, out_dir.name, sources, layout, task, crf, progress)
        summary = verify_dataset(partial, sources)
        replaced = durable.partial_path(out_dir.with_name(f"{out_dir.name}.replaced"))
        if out_dir.exists():
            out_dir.replace(replaced)
        durable.publish(partial, out_dir)
        durable.remove(replaced)
    except OSError as error:
        raise DataError(
            f"{out_dir} could not be written: {error}",
            remedy="free space on the disk or choose another folder",
        ) from error
    finally:
        durable.remove(partial)
    return DatasetSummary(**{**summary.__dict__, "root": out_dir})


def verify_dataset(root: Path | str, paths: Sequence[Path | str]) -> DatasetSummary:
    """Re-open a dataset without LeRobot and hold it against its recordings.

    Every episode must have as many rows and as many frames in each video as its recording has ticks, the
    same state and action after float32, and pictures that differ by encoding alone.

    Raises:
        DataError: naming the episode and what differs.
    """
    root = Path(root)
    data = read_dataset_to_ram(root)
    if len(data.episode_from) != len(paths):
        raise DataError(f"{root} holds {len(data.episode_from)} episodes; {len(paths)} were recorded")
    if data.state_names != STATE_NAMES or data.action_names != STATE_NAMES:
        raise DataError(f"{root} names its state {data.state_names}; it must be {STATE_NAMES}")
    state_error, image_difference = 0.0, 0.0
    for index, path in enumerate(paths):
        names = [key.removeprefix(camera_key("")) for key in data.images]
        episode = read_episode(path, cameras=names)
        errors = _compare(data, index, episode)
        state_error, image_difference = max(state_error, errors[0]), max(image_difference, errors[1])
    return DatasetSummary(
        root=root,
        episodes=len(paths),
        frames=len(data),
        cameras=tuple(data.images),
        fps=int(data.fps),
        state_error_max=state_error,
        image_difference_mean=image_difference,
    )


def read_sources(root: Path | str) -> list[dict[str, Any]]:
    """Return what a dataset was made of: for each episode its file, seed, ticks, success and extra facts."""
    path = Path(root) / SOURCES_FILE
    try:
        return list(json.loads(path.read_text(encoding="utf-8"))["episodes"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(f"{path} is missing or corrupt: {error!r}") from error


def _compare(data: RamDataset, index: int, episode: Episode) -> tuple[float, float]:
    """Return (largest state error, largest mean picture difference) of one episode, or raise DataError."""
    start, stop = int(data.episode_from[index]), int(data.episode_to[index])
    label = f"episode {index} ({episode.path.name if episode.path else 'in memory'})"
    if stop - start != len(episode):
        raise DataError(f"{label} has {stop - start} rows; {len(episode)} ticks were recorded")
    state_error = 0.0
    for name, stored, recorded in (
        (STATE, data.state, state_vector(episode.qpos, episode.gripper)),
        (ACTION, data.action, state_vector(episode.action, episode.action_gripper)),
    ):
        error = float(np.max(np.abs(stored[start:stop] - recorded)))
        if not error == 0.0:
            raise DataError(f"{label}: {name} differs from the recording by {error:.3g}")
        state_error = max(state_error, error)
    worst = 0.0
    for camera, frames in episode.images.items():
        stored = data.images[camera_key(camera)][start:stop]
        # Ticks in small blocks: int16 copies of a whole episode would need four times its memory.
        blocks = [
            float(np.mean(np.abs(stored[k : k + 32].astype(np.int16) - frames[k : k + 32])))
            for k in range(0, len(frames), 32)
        ]
        difference = max(blocks)
        if not difference <= IMAGE_DIFFERENCE_MAX:
            raise DataError(
                f"{label}: camera '{camera}' differs from the recording by {difference:.1f} of 255 on average; "
                f"the limit is {IMAGE_DIFFERENCE_MAX:g}"
            )
        worst = max(worst, difference)
    return state_error, worst


@dataclass(frozen=True)
class _Layout:
    fps: int
    cameras: tuple[str, ...]
    shapes: dict[str, tuple[int, int, int]]


def _common_layout(sources: Sequence[Path], cameras: Sequence[str] | None, fps: int | None) -> _Layout:
    """Return rate, cameras and picture sizes that all recordings share; raise DataError where they differ."""
    first, _ = read_meta(sources[0])
    if not float(first.fps).is_integer():
        raise DataError(f"{sources[0]} runs at {first.fps} Hz; LeRobot needs a whole number")
    rate = int(first.fps)
    if fps is not None and fps != rate:
        raise DataError(f"{sources[0]} runs at {rate} Hz; the dataset is asked for at {fps} Hz")
    wanted = first.cameras if cameras is None else tuple(cameras)
    for path in sources:
        meta, _ = read_meta(path)
        if meta.fps != rate:
            raise DataError(f"{path} runs at {meta.fps:g} Hz, {sources[0].name} at {rate} Hz")
        absent = [camera for camera in wanted if camera not in meta.cameras]
        if absent:
            raise DataError(
                f"{path}: no camera {', '.join(absent)}; there are {', '.join(meta.cameras) or 'none'}"
            )
    images = read_episode(sources[0], cameras=wanted).images
    return _Layout(rate, wanted, {camera: images[camera].shape[1:] for camera in wanted})


def _features(layout: _Layout) -> dict[str, dict[str, Any]]:
    features: dict[str, dict[str, Any]] = {
        key: {"dtype": "float32", "shape": (STATE_N,), "names": list(STATE_NAMES)} for key in (STATE, ACTION)
    }
    for camera, shape in layout.shapes.items():
        features[camera_key(camera)] = {
            "dtype": "video",
            "shape": tuple(shape),
            "names": ["height", "width", "channels"],
        }
    return features


def _write_dataset(
    root: Path,
    name: str,
    sources: Sequence[Path],
    layout: _Layout,
    task: str | None,
    crf: int,
    progress: Progress | None,
) -> None:
    os.environ.setdefault("HF_HUB_OFFLINE", "1")
    import av
    import datasets
    from lerobot.configs.video import RGBEncoderConfig
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    # The encoder's account of every video and a bar for every table would drown what people read on stderr.
    av.logging.set_libav_level(av.logging.ERROR)
    bars_shown = datasets.is_progress_bar_enabled()
    datasets.disable_progress_bars()
    dataset = LeRobotDataset.create(
        repo_id=f"local/{name}",
        fps=layout.fps,
        features=_features(layout),
        root=root,
        robot_type="dual_panda",
        use_videos=True,
        video_backend="pyav",
        rgb_encoder=RGBEncoderConfig(vcodec=VIDEO_CODEC, preset=VIDEO_PRESET, pix_fmt=VIDEO_PIXELS, crf=crf),
        # Streaming encoding drops frames under load with no more than a warning.
        streaming_encoding=False,
    )
    records: list[dict[str, Any]] = []
    try:
        for index, path in enumerate(sources):
            episode = read_episode(path, cameras=layout.cameras)
            for camera, shape in layout.shapes.items():
                if episode.images[camera].shape[1:] != shape:
                    raise DataError(
                        f"{path}: camera '{camera}' is {episode.images[camera].shape[1:]}, not {shape}"
                    )
            _add_episode(dataset, episode, task or episode.meta.task)
            records.append(_source_record(path, episode))
            if progress is not None:
                progress(index + 1, len(sources))
    finally:
        dataset.finalize()
        if bars_shown:
            datasets.enable_progress_bars()
    for left in root.glob("tmp*"):
        durable.remove(left)
    durable.remove(root / "images")
    text = json.dumps({"episodes": records}, indent=1, sort_keys=True)
    (root / SOURCES_FILE).write_text(text + "\n", encoding="utf-8")


def _add_episode(dataset: Any, episode: Episode, task: str) -> None:
    state = state_vector(episode.qpos, episode.gripper)
    action = state_vector(episode.action, episode.action_gripper)
    for k in range(len(episode)):
        frame: dict[str, Any] = {STATE: state[k], ACTION: action[k], "task": task}
        for camera, frames in episode.images.items():
            frame[camera_key(camera)] = frames[k]
        dataset.add_frame(frame)
    dataset.save_episode(parallel_encoding=False)


def _source_record(path: Path, episode: Episode) -> dict[str, Any]:
    return {
        "file": path.name,
        "seed": episode.meta.seed,
        "ticks": len(episode),
        "success": episode.meta.success,
        "extra": dict(episode.meta.extra),
    }
