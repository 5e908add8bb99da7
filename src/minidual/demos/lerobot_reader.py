"""Read LeRobot v3 datasets without LeRobot, to verify them independently."""

import itertools
import math
import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from minidual.durable import disk_errors, read_json, reading, regular_file
from minidual.errors import DataError, check_name
from minidual.robot.pair import Array

STATE = "observation.state"
ACTION = "action"
IMAGE_PREFIX = "observation.images.cam_"

Image = NDArray[np.uint8]
Rows = NDArray[np.int64]
_AGAIN = "record and convert again, the finished recording is kept beside it: minidual teleop-record --force"
_reading = partial(reading, remedy=_AGAIN)
_VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
PIXELS_MAX = 4096
ROWS_MAX = 10_000_000
"""Limits of a picture's sides and of a dataset's rows, checked before memory is taken."""
BYTES_MAX = 2**36  # of a file
MEMORY_SHARE = 0.5
"""Largest share of available memory for one camera."""
BRIGHTNESS_MAX = 0.03
"""Limit of a video's difference to the mean that LeRobot recorded, by colour; 1 is full scale."""


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
        size = self.cameras[camera]
        with _reading(f"{self.root}: the table of videos"):
            videos = self._videos(camera_key(camera))
        parts = (
            zip(rows.tolist(), _decode(self.root / n, len(rows), size), strict=True)
            for n, rows in videos.items()
        )
        return itertools.chain.from_iterable(parts)

    def images(
        self,
        camera: str,
        progress: Callable[[int], None] | None = None,
        folder: Path | None = None,
    ) -> Image:
        """Return all images (N, H, W, 3), mapped from a file in `folder` if memory is short; raises as `frames`.

        `progress` gets the count since its last call.
        """
        frames = self.frames(camera)
        result = _room_for((len(self), *self.cameras[camera], 3), folder)
        for count, (row, image) in enumerate(frames, start=1):
            result[row] = image
            if progress is not None and (count % 1000 == 0 or count == len(self)):
                progress((count - 1) % 1000 + 1)
        recorded = f"stats/{camera_key(camera)}/mean"
        if recorded in self._episodes.column_names:
            for e, (start, stop) in enumerate(zip(self.starts, self.stops, strict=True)):
                every = max(1, (stop - start) // 100)  # LeRobot samples as many
                mean, _ = colours(result[start:stop:every])
                apart = float(np.abs(mean - np.ravel(self._episodes[recorded][e].as_py())).max())
                if not apart <= BRIGHTNESS_MAX:
                    other = f"mean colour {apart:.3f} apart, limit {BRIGHTNESS_MAX:g}"
                    what = f"camera '{camera}' of episode {e} shows other pictures than were recorded ({other})"
                    raise DataError(f"{self.root}: {what}", remedy=_AGAIN)
        return result

    def _videos(self, key: str) -> dict[str, Rows]:
        chunk, file = (
            _integers(self._episodes, f"videos/{key}/{name}")
            for name in ("chunk_index", "file_index")
        )
        begin = np.asarray(self._episodes[f"videos/{key}/from_timestamp"].to_numpy(), dtype=float)
        parts: dict[str, list[Rows]] = {}
        for e in np.lexsort((begin, file, chunk)):
            name = _VIDEO_PATH.format(
                video_key=key,
                chunk_index=int(chunk[e]),
                file_index=int(file[e]),
            )
            expected = sum(map(len, parts.setdefault(name, [])))
            if not abs(begin[e] * self.fps - expected) <= 0.5:
                where = f"episode {int(e)} does not begin at frame {expected} as the tables say"
                raise DataError(f"{self.root / name}: {where}")
            parts[name].append(np.arange(self.starts[e], self.stops[e]))
        return {name: np.concatenate(rows) for name, rows in parts.items()}


def colours(images: Image) -> tuple[Array, Array]:
    """Return mean and std (3,) in [0, 1] of images (N, H, W, 3)."""
    each = np.array([cv2.meanStdDev(image) for image in images])[..., 0] / 255.0
    mean = each[:, 0].mean(axis=0)
    return mean, np.sqrt(np.maximum((each**2).sum(axis=1).mean(axis=0) - mean**2, 0.0))


def read_dataset(root: Path | str) -> LeRobotTables:
    """Read the tables; DataError if missing, corrupt or inconsistent."""
    root = Path(root)
    path = root / "meta" / "info.json"
    if not path.is_file():
        raise DataError(f"no LeRobot dataset at {root} (meta/info.json is missing)", remedy=_AGAIN)
    with _reading(path):
        info = read_json(path)
        version = str(info["codebase_version"])
        features = info["features"]
        fps = float(info["fps"])
        declared = (int(info["total_frames"]), int(info["total_episodes"]))
        names, action_names = (tuple(map(str, features[key]["names"])) for key in (STATE, ACTION))
        shapes = {
            key.removeprefix(IMAGE_PREFIX): f["shape"]
            for key, f in features.items()
            if IMAGE_PREFIX in key
        }
        cameras = {camera: (int(shape[0]), int(shape[1])) for camera, shape in shapes.items()}
        if not (
            0.0 < fps < 1e5 and 0 <= declared[0] <= ROWS_MAX and info["video_path"] == _VIDEO_PATH
        ):
            raise ValueError(
                f"fps {fps:g}, {declared[0]} frames or the video path is out of bounds",
            )
        if large := [
            camera for camera, size in cameras.items() if not all(0 < n <= PIXELS_MAX for n in size)
        ]:
            raise ValueError(f"camera '{large[0]}' has a size outside 1 to {PIXELS_MAX} pixels")
    if not version.startswith("v3"):
        raise DataError(f"{root} is a LeRobot dataset of version {version}; this program reads v3")
    table = _read_parquet(root, "data")
    episodes = _read_parquet(root, "meta/episodes")
    with _reading(f"{root}: a table"):
        state, action = (
            np.stack(table[key].to_numpy()).astype(np.float32) for key in (STATE, ACTION)
        )
        index, episode, frame = (
            _integers(table, key) for key in ("index", "episode_index", "frame_index")
        )
        starts, stops = (
            _integers(episodes, key) for key in ("dataset_from_index", "dataset_to_index")
        )
        rows = np.arange(len(index))
        if not all(
            values.shape == (len(rows), len(names)) and np.isfinite(values).all()
            for values in (state, action)
        ):
            raise ValueError(
                f"state {state.shape} or action {action.shape} is not finite or not as declared",
            )
        if declared != (len(rows), len(starts)):
            held = f"the tables hold {len(rows)} in {len(starts)}"
            raise ValueError(
                f"info.json declares {declared[0]} frames in {declared[1]} episodes, {held}",
            )
        ok = np.array_equal(np.r_[starts, len(rows)], np.r_[0, stops]) and np.all(stops > starts)
        if not (
            ok
            and np.array_equal(index, rows)
            and np.array_equal(frame, rows - np.repeat(starts, stops - starts))
        ):
            raise ValueError("row or frame indices do not run without gaps")
        if action_names != names:
            raise ValueError(f"action is named {action_names}, state {names}")
    return LeRobotTables(
        root,
        fps,
        names,
        cameras,
        *(state, action, episode, frame, starts, stops),
        episodes,
    )


def _room_for(shape: tuple[int, ...], folder: Path | None) -> Image:
    """Return an array; one over `MEMORY_SHARE` lies in a nameless file."""
    size = math.prod(shape)
    if folder is None or size <= MEMORY_SHARE * psutil.virtual_memory().available:
        return np.empty(shape, dtype=np.uint8)
    with disk_errors(folder), tempfile.TemporaryFile(dir=folder) as file:
        os.posix_fallocate(file.fileno(), 0, size)  # a full disk shows here, not as SIGBUS
        return np.asarray(np.memmap(file, dtype=np.uint8, shape=shape))


def _integers(table: Any, key: str) -> Rows:
    with np.errstate(invalid="raise"):
        return np.asarray(table[key].to_numpy(), dtype=np.int64)


def _read_parquet(root: Path, folder: str) -> Any:
    if not (paths := sorted((root / folder).glob("chunk-*/file-*.parquet"))):
        raise DataError(f"{root} holds no parquet tables under {folder}", remedy=_AGAIN)
    tables: list[Any] = []
    for path in paths:
        with _reading(path), pq.ParquetFile(regular_file(path, BYTES_MAX)) as file:
            if file.metadata.num_rows > ROWS_MAX:
                raise ValueError(f"{file.metadata.num_rows} rows; at most {ROWS_MAX}")
            tables.append(file.read())
    with _reading(root / folder):
        return pa.concat_tables(tables, promote_options="default")


def _decode(path: Path, expected: int, size: tuple[int, int]) -> Iterator[Image]:
    count = 0
    with _reading(path), av.open(str(regular_file(path, BYTES_MAX)), format="mp4") as container:
        container.streams.video[
            0
        ].thread_type = "AUTO"  # the next picture is decoded while one is converted
        for count, frame in enumerate(container.decode(video=0), start=1):
            if (frame.height, frame.width) != size:
                raise ValueError(
                    f"its pictures are {frame.height} x {frame.width}, declared {size[0]} x {size[1]}",
                )
            if count > expected:
                break
            shown: Any = frame.to_ndarray(
                format="rgb24",
                width=size[1],
                height=size[0],
                interpolation="AREA",
            )
            yield shown
    if count != expected:
        held = f"more than {expected}" if count > expected else count
        raise DataError(
            f"{path} holds {held} frames; the table has {expected} rows for it",
            remedy=_AGAIN,
        )
