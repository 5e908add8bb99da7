"""Read LeRobot v3 datasets without LeRobot, to verify them independently."""

import math
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from minidual.demos.lerobot_features import (
    ACTION,
    IMAGE_PREFIX,
    ROWS_MAX,
    STATE,
    VIDEO_PATH,
    CameraFeature,
    DatasetInfo,
    camera_key,
    camera_name,
    read_info,
    reading,
    remedy_of,
    signal_key,
)
from minidual.demos.lerobot_video import (
    BRIGHTNESS_MAX,
    BYTES_MAX,
    Image,
    colour_difference,
    colours,
    data_files,
    decoded,
    stored_in_tables,
)
from minidual.durable import disk_errors, regular_file
from minidual.errors import DataError, check_name
from minidual.robot.pair import Array

__all__ = [
    "ACTION",
    "IMAGE_PREFIX",
    "STATE",
    "LeRobotTables",
    "Rows",
    "camera_key",
    "camera_name",
    "colours",
    "has_signal",
    "read_dataset",
    "read_signal",
]

Rows = NDArray[np.int64]

MEMORY_SHARE = 0.5
"""Largest share of available memory for one camera."""
_PROGRESS_EVERY = 1000
_TICK_COLUMNS = [STATE, ACTION, "episode_index", "frame_index", "index"]


@dataclass(frozen=True)
class LeRobotTables:
    """Checked tables: N rows, E episodes.

    Attributes:
        names, action_names: Entries of states and of actions.
        cameras: (H, W) by camera.
        state, action: (N, entries).
        frame_index: (N,) from 0 per episode.
        starts, stops: (E,) first rows, and one past the last.
    """

    root: Path
    fps: float
    names: tuple[str, ...]
    action_names: tuple[str, ...]
    cameras: dict[str, tuple[int, int]]
    state: NDArray[np.float32]
    action: NDArray[np.float32]
    episode_index: Rows
    frame_index: Rows
    starts: Rows
    stops: Rows
    info: DatasetInfo
    _episodes: Any

    def __len__(self) -> int:
        return len(self.state)

    def frames(self, camera: str) -> Iterator[tuple[int, Image]]:
        """Stream (row, image (H, W, 3)).

        Raises:
            UsageError: Unknown camera.
            DataError: Corrupt video; at its end, wrong frame count.
        """
        check_name("camera", camera, self.cameras)
        key = camera_key(camera)
        size = self.cameras[camera]
        if self.info.cameras[camera].stored == "image":
            return enumerate(self._one_each_row(key, stored_in_tables(self.root, key, size)))
        with reading(f"{self.root}: the table of videos", self.root):
            videos = self._videos(key)
        return self._frames(videos, size)

    def images(
        self,
        camera: str,
        progress: Callable[[int], None] | None = None,
        folder: Path | None = None,
        *,
        height: int | None = None,
    ) -> Image:
        """Return all images (N, H, W, 3); raises as `frames`.

        They are mapped from a file in `folder` if memory is short. `progress` gets the count since
        its last call. Higher images than `height` are scaled down to it.
        """
        frames = self.frames(camera)
        size = scaled_size(self.cameras[camera], height)
        images = _room_for((len(self), *size, 3), folder)
        for count, (row, image) in enumerate(frames, start=1):
            if image.shape[:2] != size:
                image = cv2.resize(image, size[::-1], interpolation=cv2.INTER_AREA)
            images[row] = image
            if progress is not None and (count % _PROGRESS_EVERY == 0 or count == len(self)):
                progress((count - 1) % _PROGRESS_EVERY + 1)
        self._check_colours(camera, images)
        return images

    def instructions(self) -> list[str]:
        """Return the instruction of each episode, "" where the dataset keeps none."""
        if "tasks" not in self._episodes.column_names:
            return [""] * len(self.starts)
        return ["; ".join(map(str, texts or ())) for texts in self._episodes["tasks"].to_pylist()]

    def recorded_colour(self, camera: str, episode: int) -> Array | None:
        """Return the mean colour (3,) that LeRobot recorded of an episode, None if it did not."""
        column = f"stats/{camera_key(camera)}/mean"
        if column not in self._episodes.column_names:
            return None
        recorded = np.ravel(np.array(self._episodes[column][episode].as_py(), dtype=float))
        return recorded if len(recorded) == 3 else None

    def _check_colours(self, camera: str, images: Image) -> None:
        """Raise DataError if an episode's mean colour is not the recorded one."""
        for episode, (start, stop) in enumerate(zip(self.starts, self.stops, strict=True)):
            recorded = self.recorded_colour(camera, episode)
            if recorded is None:
                continue
            difference = colour_difference(images[start:stop], recorded)
            if not difference <= BRIGHTNESS_MAX:  # NaN fails too
                raise DataError(
                    f"{self.root}: camera '{camera}' of episode {episode} shows other pictures "
                    f"than were recorded (mean colour {difference:.3f} apart, "
                    f"limit {BRIGHTNESS_MAX:g})",
                    remedy=remedy_of(self.root),
                )

    def _one_each_row(self, key: str, images: Iterator[Image]) -> Iterator[Image]:
        """Yield images; DataError unless there is one for each row."""
        count = 0
        for count, image in enumerate(images, start=1):
            if count > len(self):
                break
            yield image
        if count != len(self):
            raise DataError(
                f"{self.root}: '{key}' has other than {len(self)} pictures, one for each row",
                remedy=remedy_of(self.root),
            )

    def _frames(
        self,
        videos: dict[str, Rows],
        size: tuple[int, int],
    ) -> Iterator[tuple[int, Image]]:
        for name, rows in videos.items():
            images = decoded(self.root, name, len(rows), size)
            yield from zip(rows.tolist(), images, strict=True)

    def _videos(self, key: str) -> dict[str, Rows]:
        """Return each video file's rows, in its order."""
        chunk = _integers(self._episodes, f"videos/{key}/chunk_index")
        file = _integers(self._episodes, f"videos/{key}/file_index")
        begin_s = np.asarray(
            self._episodes[f"videos/{key}/from_timestamp"].to_numpy(),
            dtype=float,
        )
        parts: dict[str, list[Rows]] = {}
        for episode in np.lexsort((begin_s, file, chunk)):
            name = VIDEO_PATH.format(
                video_key=key,
                chunk_index=int(chunk[episode]),
                file_index=int(file[episode]),
            )
            rows_before = parts.setdefault(name, [])
            frames_before_n = sum(map(len, rows_before))
            if not abs(begin_s[episode] * self.fps - frames_before_n) <= 0.5:  # NaN fails too
                raise DataError(
                    f"{self.root / name}: episode {int(episode)} does not begin "
                    f"at frame {frames_before_n} as the tables say",
                )
            rows_before.append(np.arange(self.starts[episode], self.stops[episode]))
        return {name: np.concatenate(rows) for name, rows in parts.items()}


def scaled_size(size: tuple[int, int], height: int | None) -> tuple[int, int]:
    """Return the size (H, W) of images that are scaled down to a height; None leaves them."""
    if height is None or size[0] <= height:
        return size
    return height, max(1, round(size[1] * height / size[0]))


def read_dataset(root: Path | str) -> LeRobotTables:
    """Read the tables; DataError if missing, corrupt or inconsistent."""
    root = Path(root)
    info = read_info(root)
    rows = _read_parquet(root, data_files(root), "data", _TICK_COLUMNS)
    episode_files = sorted((root / "meta" / "episodes").glob("chunk-*/file-*.parquet"))
    episodes = _read_parquet(root, episode_files, "meta/episodes")
    with reading(f"{root}: a table", root):
        tables = LeRobotTables(
            root=root,
            fps=info.fps,
            names=info.names,
            action_names=info.action_names,
            cameras=_sizes(info.cameras),
            state=_vectors(rows, STATE),
            action=_vectors(rows, ACTION),
            episode_index=_integers(rows, "episode_index"),
            frame_index=_integers(rows, "frame_index"),
            starts=_integers(episodes, "dataset_from_index"),
            stops=_integers(episodes, "dataset_to_index"),
            info=info,
            _episodes=episodes,
        )
        _check_consistent(tables, _integers(rows, "index"), info)
    return tables


def has_signal(root: Path | str, name: str) -> bool:
    """Return whether the dataset holds a recorded signal.

    Raises:
        DataError: The first table is corrupt.
    """
    root = Path(root)
    files = data_files(root)
    if not files:
        return False
    with reading(files[0], root):
        columns = pq.read_schema(files[0]).names
    return signal_key(name) in columns


def read_signal(root: Path | str, name: str) -> NDArray[np.float32] | None:
    """Return a recorded signal (N, entries), None if the dataset has it not.

    Raises:
        DataError: The tables are missing or corrupt.
    """
    root = Path(root)
    key = signal_key(name)
    if not has_signal(root, name):
        return None
    table = _read_parquet(root, data_files(root), "data", [key])
    with reading(f"{root}: '{key}'", root):
        return _vectors(table, key)


def _sizes(cameras: dict[str, CameraFeature]) -> dict[str, tuple[int, int]]:
    return {name: (feature.height, feature.width) for name, feature in cameras.items()}


def _check_consistent(tables: LeRobotTables, index: Rows, info: DatasetInfo) -> None:
    """Raise ValueError unless the tables agree with each other and with info.json.

    `index` is the column of row numbers.
    """
    rows = np.arange(len(index))
    for values, names in ((tables.state, info.names), (tables.action, info.action_names)):
        if values.shape != (len(rows), len(names)) or not np.isfinite(values).all():
            raise ValueError(
                f"state {tables.state.shape} or action {tables.action.shape} "
                "is not finite or not as declared",
            )
    if (info.frames_n, info.episodes_n) != (len(rows), len(tables.starts)):
        raise ValueError(
            f"info.json declares {info.frames_n} frames in {info.episodes_n} episodes, "
            f"the tables hold {len(rows)} in {len(tables.starts)}",
        )
    if not _without_gaps(tables, index):
        raise ValueError("row or frame indices do not run without gaps")


def _without_gaps(tables: LeRobotTables, index: Rows) -> bool:
    starts = tables.starts
    stops = tables.stops
    rows = np.arange(len(index))
    contiguous = np.array_equal(np.r_[starts, len(rows)], np.r_[0, stops])
    if not (contiguous and np.all(stops > starts)):
        return False
    frames = rows - np.repeat(starts, stops - starts)
    return np.array_equal(index, rows) and np.array_equal(tables.frame_index, frames)


def _room_for(shape: tuple[int, ...], folder: Path | None) -> Image:
    """Return an array; one over `MEMORY_SHARE` lies in a nameless file."""
    size = math.prod(shape)
    if folder is None or size <= MEMORY_SHARE * psutil.virtual_memory().available:
        return np.empty(shape, dtype=np.uint8)
    with disk_errors(folder), tempfile.TemporaryFile(dir=folder) as file:
        os.posix_fallocate(file.fileno(), 0, size)  # a full disk shows here, not as SIGBUS
        return np.asarray(np.memmap(file, dtype=np.uint8, shape=shape))


def _vectors(table: Any, key: str) -> NDArray[np.float32]:
    """Return a column (N, entries); one entry a row is stored as a number."""
    values = np.stack(table[key].to_numpy()).astype(np.float32)
    return values.reshape(len(values), -1)


def _integers(table: Any, key: str) -> Rows:
    with np.errstate(invalid="raise"):
        return np.asarray(table[key].to_numpy(), dtype=np.int64)


def _read_parquet(
    root: Path,
    paths: Sequence[Path],
    folder: str,
    columns: list[str] | None = None,
) -> Any:
    if not paths:
        raise DataError(
            f"{root} holds no parquet tables under {folder}",
            remedy=remedy_of(root),
        )
    tables: list[Any] = []
    for path in paths:
        with reading(path, root), pq.ParquetFile(regular_file(path, BYTES_MAX)) as file:
            if file.metadata.num_rows > ROWS_MAX:
                raise ValueError(f"{file.metadata.num_rows} rows; at most {ROWS_MAX}")
            tables.append(file.read(columns))
    with reading(root / folder, root):
        return pa.concat_tables(tables, promote_options="default")
