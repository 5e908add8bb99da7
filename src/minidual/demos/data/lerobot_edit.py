"""Write, join and divide LeRobot datasets, by LeRobot's own tools."""

import contextlib
import io
import json
import os
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("HF_HUB_OFFLINE", "1")  # LeRobot reads it on import

import numpy as np
from lerobot.datasets.aggregate import aggregate_datasets
from lerobot.datasets.dataset_tools import split_dataset
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from minidual.demos.data.source import DataEpisode, DataSource, Image
from minidual.demos.lerobot_adapter import VIDEO_ENCODING, quiet_and_fast
from minidual.demos.lerobot_features import ACTION, SOURCES_FILE, STATE, camera_key, is_own
from minidual.durable import read_json
from minidual.errors import DataError

_EFFORT = "observation.effort"


def join_datasets(roots: Sequence[Path], out: Path) -> None:
    """Write a new dataset of the episodes of all, in order."""
    names = [f"local/part_{k}" for k in range(len(roots))]
    with _silent():
        aggregate_datasets(names, "local/merged", roots=list(roots), aggr_root=out)
    if all(is_own(root) for root in roots):
        records = [record for root in roots for record in _sources(root)]
        _write_sources(out, records)


def divide_dataset(root: Path, parts: Mapping[str, Sequence[int]], out: Path) -> None:
    """Write a new dataset `out`/NAME for each part, of its episodes in ascending order."""
    with _silent():
        dataset = LeRobotDataset("local/whole", root=root, video_backend="pyav")
        split_dataset(dataset, {name: sorted(of) for name, of in parts.items()}, output_dir=out)
    if is_own(root):
        records = _sources(root)
        for name, numbers in parts.items():
            _write_sources(out / name, [records[number] for number in sorted(numbers)])


def write_dataset(sources: Sequence[DataSource], out: Path) -> None:
    """Write a new dataset of the episodes of any sources, which must have one format.

    Raises:
        DataError: An episode cannot be read.
    """
    episodes = [_readable(source) for source in sources]
    first = episodes[0][0]
    with_effort = all(episode.effort is not None for part in episodes for episode in part)
    with quiet_and_fast():
        dataset = LeRobotDataset.create(
            repo_id=f"local/{out.name}",
            fps=round(first.rate_hz),
            features=_features(first, with_effort=with_effort),
            root=out,
            use_videos=bool(first.cameras),
            video_backend="pyav",
            rgb_encoder=VIDEO_ENCODING,
        )
        with contextlib.closing(_Finalising(dataset)):
            for source, part in zip(sources, episodes, strict=True):
                for number, images in _pictures_of(source, part, tuple(first.cameras)):
                    _add(dataset, part[number], images, with_effort=with_effort)


class _Finalising:
    """Closes a dataset that is written."""

    def __init__(self, dataset: LeRobotDataset) -> None:
        self._dataset = dataset

    def close(self) -> None:
        self._dataset.finalize()


def _readable(source: DataSource) -> list[DataEpisode]:
    episodes: list[DataEpisode] = []
    for reading in source.episodes():
        if reading.episode is None:
            raise DataError(
                f"{source.root}: {reading.name} cannot be read: {reading.faults[0]}",
                remedy=f"minidual data check {source.root}; take the file out, or mend it",
            )
        episodes.append(reading.episode)
    return episodes


def _features(episode: DataEpisode, *, with_effort: bool) -> dict[str, dict[str, Any]]:
    features = {
        STATE: _vector(episode.state_names),
        ACTION: _vector(episode.action_names),
    }
    if with_effort:
        assert episode.effort is not None
        features[_EFFORT] = _vector(tuple(f"effort_{k}" for k in range(episode.effort.shape[1])))
    for camera, (height, width) in episode.cameras.items():
        features[_feature_of(camera)] = {
            "dtype": "video",
            "shape": (height, width, 3),
            "names": ["height", "width", "channels"],
        }
    return features


def _feature_of(camera: str) -> str:
    """Return a camera's feature; ALOHA's own names begin with "cam_" already."""
    return camera_key(camera.removeprefix("cam_"))


def _vector(names: Sequence[str]) -> dict[str, Any]:
    return {"dtype": "float32", "shape": (len(names),), "names": list(names)}


def _pictures_of(
    source: DataSource,
    episodes: Sequence[DataEpisode],
    cameras: Sequence[str],
) -> Generator[tuple[int, dict[str, Image]]]:
    """Yield (number, pictures by camera) of each episode, in order."""
    streams = {camera: source.pictures(camera) for camera in cameras}
    for number in range(len(episodes)):
        yield number, {camera: next(stream)[1] for camera, stream in streams.items()}


def _add(
    dataset: LeRobotDataset,
    episode: DataEpisode,
    images: Mapping[str, Image],
    *,
    with_effort: bool,
) -> None:
    state = episode.state.astype(np.float32)
    action = episode.action.astype(np.float32)
    for tick in range(len(episode)):
        frame: dict[str, Any] = {STATE: state[tick], ACTION: action[tick]}
        if with_effort:
            assert episode.effort is not None
            frame[_EFFORT] = episode.effort[tick].astype(np.float32)
        for camera, frames in images.items():
            frame[_feature_of(camera)] = frames[tick]
        dataset.add_frame({**frame, "task": episode.task or "no instruction"})
    dataset.save_episode(parallel_encoding=False)


def _sources(root: Path) -> list[dict[str, Any]]:
    return list(read_json(root / SOURCES_FILE)["episodes"])


def _write_sources(root: Path, records: Sequence[Mapping[str, Any]]) -> None:
    text = json.dumps({"episodes": list(records)}, indent=1, sort_keys=True)
    (root / SOURCES_FILE).write_text(text + "\n", encoding="utf-8")


@contextlib.contextmanager
def _silent() -> Generator[None]:
    """Keep LeRobot's progress bars from stderr; errors are raised."""
    with contextlib.redirect_stderr(io.StringIO()):
        yield
