"""From recorded HDF5 episodes to a LeRobot v3 dataset.

This adapter (with `lerobot_mapping`, the table of names, and `lerobot_verify`, the check of its result) is the
only code that knows both schemas.

Videos keep full colour resolution (4:4:4) at crf 12: with the usual 4:2:0 at crf 30 a rod two pixels wide
loses its colour, and the policy would train on other pictures than it meets (measured on rendered 96x128
frames, mean difference per channel: 7.7 of 255 against 2.1; 2.3 kB a frame).
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from minidual import durable
from minidual.demos.episode import Episode, read_episode, read_meta
from minidual.demos.lerobot_mapping import STATE_N, STATE_NAMES, camera_key, split_vector, state_vector
from minidual.demos.lerobot_reader import ACTION, STATE
from minidual.demos.lerobot_verify import DatasetSummary, verify_dataset
from minidual.errors import DataError, UsageError

__all__ = [
    "STATE_NAMES",
    "DatasetSummary",
    "camera_key",
    "convert",
    "read_sources",
    "split_vector",
    "state_vector",
    "verify_dataset",
]

#: Where a dataset says which recordings it was made of.
SOURCES_FILE = "meta/minidual_sources.json"

VIDEO_CODEC = "h264"
VIDEO_PRESET = "veryfast"
VIDEO_PIXELS = "yuv444p"
VIDEO_CRF = 12

Progress = Callable[[int, int], None]


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
        raise UsageError(f"{out_dir} exists already", remedy="remove it, choose another folder, or overwrite it")
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
            f"{out_dir} could not be written: {error}", remedy="free space on the disk or choose another folder"
        ) from error
    finally:
        durable.remove(partial)
    return replace(summary, root=out_dir)


def read_sources(root: Path | str) -> list[dict[str, Any]]:
    """Return what a dataset was made of: for each episode its file, seed, ticks, success and extra facts."""
    path = Path(root) / SOURCES_FILE
    try:
        return list(json.loads(path.read_text(encoding="utf-8"))["episodes"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(f"{path} is missing or corrupt: {error!r}") from error


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
            raise DataError(f"{path}: no camera {', '.join(absent)}; there are {', '.join(meta.cameras) or 'none'}")
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
                    raise DataError(f"{path}: camera '{camera}' is {episode.images[camera].shape[1:]}, not {shape}")
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
