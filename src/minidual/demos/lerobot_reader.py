"""Read LeRobot v3 datasets without LeRobot, to verify them independently."""

import math
import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from minidual.demos.lerobot_video import BYTES_MAX, REMEDY, VIDEO_PATH, Image, decoded, reading
from minidual.durable import disk_errors, read_json, regular_file
from minidual.errors import DataError, check_name
from minidual.robot.pair import Array

STATE = "observation.state"
ACTION = "action"
IMAGE_PREFIX = "observation.images.cam_"

Rows = NDArray[np.int64]

FPS_MAX = 1e5
PIXELS_MAX = 4096
ROWS_MAX = 10_000_000
"""Limits of the rate, a picture's sides and a dataset's rows, checked before memory is taken."""
MEMORY_SHARE = 0.5
"""Largest share of available memory for one camera."""
BRIGHTNESS_MAX = 0.03
"""Limit of a video's difference to the mean that LeRobot recorded, by colour; 1 is full scale."""
_LEROBOT_SAMPLES_N = 100
"""Pictures of an episode from which LeRobot takes the mean."""
_PROGRESS_EVERY = 1000


def camera_key(camera: str) -> str:
    """Return e.g. "observation.images.cam_high"."""
    return IMAGE_PREFIX + camera


@dataclass(frozen=True)
class LeRobotTables:
    """Checked tables: N rows, E episodes.

    Attributes:
        names: Entries of states and actions.
        cameras: (H, W) by camera.
        state, action: (N, names).
        frame_index: (N,) from 0 per episode.
        starts, stops: (E,) first rows, and one past the last.
    """

    root: Path
    fps: float
    names: tuple[str, ...]
    cameras: dict[str, tuple[int, int]]
    state: NDArray[np.float32]
    action: NDArray[np.float32]
    episode_index: Rows
    frame_index: Rows
    starts: Rows
    stops: Rows
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
        with reading(f"{self.root}: the table of videos"):
            videos = self._videos(camera_key(camera))
        return self._frames(videos, self.cameras[camera])

    def images(
        self,
        camera: str,
        progress: Callable[[int], None] | None = None,
        folder: Path | None = None,
    ) -> Image:
        """Return all images (N, H, W, 3); raises as `frames`.

        They are mapped from a file in `folder` if memory is short. `progress` gets the count since
        its last call.
        """
        frames = self.frames(camera)
        images = _room_for((len(self), *self.cameras[camera], 3), folder)
        for count, (row, image) in enumerate(frames, start=1):
            images[row] = image
            if progress is not None and (count % _PROGRESS_EVERY == 0 or count == len(self)):
                progress((count - 1) % _PROGRESS_EVERY + 1)
        self._check_colours(camera, images)
        return images

    def _check_colours(self, camera: str, images: Image) -> None:
        """Raise DataError if an episode's mean colour is not the recorded one."""
        column = f"stats/{camera_key(camera)}/mean"
        if column not in self._episodes.column_names:
            return
        for episode, (start, stop) in enumerate(zip(self.starts, self.stops, strict=True)):
            every = max(1, (stop - start) // _LEROBOT_SAMPLES_N)
            mean, _ = colours(images[start:stop:every])
            recorded = np.ravel(self._episodes[column][episode].as_py())
            difference = float(np.abs(mean - recorded).max())
            if not difference <= BRIGHTNESS_MAX:  # NaN fails too
                raise DataError(
                    f"{self.root}: camera '{camera}' of episode {episode} shows other pictures "
                    f"than were recorded (mean colour {difference:.3f} apart, "
                    f"limit {BRIGHTNESS_MAX:g})",
                    remedy=REMEDY,
                )

    def _frames(
        self,
        videos: dict[str, Rows],
        size: tuple[int, int],
    ) -> Iterator[tuple[int, Image]]:
        for name, rows in videos.items():
            images = decoded(self.root / name, len(rows), size)
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


def colours(images: Image) -> tuple[Array, Array]:
    """Return mean and std (3,) in [0, 1] of images (N, H, W, 3)."""
    each = np.array([cv2.meanStdDev(image) for image in images])[..., 0] / 255.0
    mean = each[:, 0].mean(axis=0)
    mean_square = (each**2).sum(axis=1).mean(axis=0)
    return mean, np.sqrt(np.maximum(mean_square - mean**2, 0.0))


class _Info(NamedTuple):
    """What meta/info.json declares."""

    version: str
    fps: float
    frames_n: int
    episodes_n: int
    names: tuple[str, ...]
    action_names: tuple[str, ...]
    cameras: dict[str, tuple[int, int]]


def read_dataset(root: Path | str) -> LeRobotTables:
    """Read the tables; DataError if missing, corrupt or inconsistent."""
    root = Path(root)
    info = _read_info(root)
    rows = _read_parquet(root, "data")
    episodes = _read_parquet(root, "meta/episodes")
    with reading(f"{root}: a table"):
        tables = LeRobotTables(
            root=root,
            fps=info.fps,
            names=info.names,
            cameras=info.cameras,
            state=_vectors(rows, STATE),
            action=_vectors(rows, ACTION),
            episode_index=_integers(rows, "episode_index"),
            frame_index=_integers(rows, "frame_index"),
            starts=_integers(episodes, "dataset_from_index"),
            stops=_integers(episodes, "dataset_to_index"),
            _episodes=episodes,
        )
        _check_consistent(tables, _integers(rows, "index"), info)
    return tables


def _read_info(root: Path) -> _Info:
    path = root / "meta" / "info.json"
    if not path.is_file():
        raise DataError(
            f"no LeRobot dataset at {root} (meta/info.json is missing)",
            remedy=REMEDY,
        )
    with reading(path):
        record = read_json(path)
        features = record["features"]
        info = _Info(
            version=str(record["codebase_version"]),
            fps=float(record["fps"]),
            frames_n=int(record["total_frames"]),
            episodes_n=int(record["total_episodes"]),
            names=tuple(map(str, features[STATE]["names"])),
            action_names=tuple(map(str, features[ACTION]["names"])),
            cameras=_declared_cameras(features),
        )
        _check_bounds(info, record["video_path"])
    if not info.version.startswith("v3"):
        raise DataError(
            f"{root} is a LeRobot dataset of version {info.version}; this program reads v3",
        )
    return info


def _declared_cameras(features: dict[str, Any]) -> dict[str, tuple[int, int]]:
    cameras: dict[str, tuple[int, int]] = {}
    for key, feature in features.items():
        if IMAGE_PREFIX in key:
            shape = feature["shape"]
            cameras[key.removeprefix(IMAGE_PREFIX)] = (int(shape[0]), int(shape[1]))
    return cameras


def _check_bounds(info: _Info, video_path: str) -> None:
    """Raise ValueError for what a dataset cannot have."""
    rate_ok = 0.0 < info.fps < FPS_MAX
    count_ok = 0 <= info.frames_n <= ROWS_MAX
    if not (rate_ok and count_ok and video_path == VIDEO_PATH):
        raise ValueError(
            f"fps {info.fps:g}, {info.frames_n} frames or the video path is out of bounds",
        )
    for camera, size in info.cameras.items():
        if not all(0 < n <= PIXELS_MAX for n in size):
            raise ValueError(f"camera '{camera}' has a size outside 1 to {PIXELS_MAX} pixels")


def _check_consistent(tables: LeRobotTables, index: Rows, info: _Info) -> None:
    """Raise ValueError unless the tables agree with each other and with info.json.

    `index` is the column of row numbers.
    """
    rows = np.arange(len(index))
    shape = (len(rows), len(info.names))
    for values in (tables.state, tables.action):
        if values.shape != shape or not np.isfinite(values).all():
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
    if info.action_names != info.names:
        raise ValueError(f"action is named {info.action_names}, state {info.names}")


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
    return np.stack(table[key].to_numpy()).astype(np.float32)


def _integers(table: Any, key: str) -> Rows:
    with np.errstate(invalid="raise"):
        return np.asarray(table[key].to_numpy(), dtype=np.int64)


def _read_parquet(root: Path, folder: str) -> Any:
    paths = sorted((root / folder).glob("chunk-*/file-*.parquet"))
    if not paths:
        raise DataError(f"{root} holds no parquet tables under {folder}", remedy=REMEDY)
    tables: list[Any] = []
    for path in paths:
        with reading(path), pq.ParquetFile(regular_file(path, BYTES_MAX)) as file:
            if file.metadata.num_rows > ROWS_MAX:
                raise ValueError(f"{file.metadata.num_rows} rows; at most {ROWS_MAX}")
            tables.append(file.read())
    with reading(root / folder):
        return pa.concat_tables(tables, promote_options="default")
