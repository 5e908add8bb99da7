"""Reading a LeRobot v3 dataset without LeRobot: parquet by pyarrow, mp4 by av.

It serves two ends. Training decodes every picture once into uint8 memory (about 30 to 60 times the rate of
random access into the videos), and verification opens what LeRobot wrote by a path LeRobot has no part in.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minidual.errors import DataError, unknown_name

STATE = "observation.state"
ACTION = "action"
IMAGE_PREFIX = "observation.images."

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class RamDataset:
    """A whole dataset in memory; N rows over E episodes, in the order of the files.

    Attributes:
        fps: Recording rate, 1/s.
        state: (N, 16) float32: 14 joints (rad, left then right), then the left and right gripper.
        action: (N, 16) float32, in the same order.
        images: (N, H, W, 3) uint8 by LeRobot key, e.g. ``observation.images.cam_high``.
        episode_index: (N,) int64.
        frame_index: (N,) int64, from 0 in each episode.
        episode_from: (E,) int64, first row of each episode.
        episode_to: (E,) int64, one past its last row.
        state_names: The 16 names of `state`.
        action_names: The 16 names of `action`.
    """

    fps: float
    state: NDArray[np.float32]
    action: NDArray[np.float32]
    images: dict[str, NDArray[np.uint8]]
    episode_index: NDArray[np.int64]
    frame_index: NDArray[np.int64]
    episode_from: NDArray[np.int64]
    episode_to: NDArray[np.int64]
    state_names: tuple[str, ...]
    action_names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.state)


def read_info(root: Path | str) -> dict[str, Any]:
    """Return the dataset's ``meta/info.json``; raise DataError if it is missing or broken."""
    path = Path(root) / "meta" / "info.json"
    try:
        info = json.loads(path.read_text(encoding="utf-8"))
        version = str(info["codebase_version"])
        if not version.startswith("v3"):
            raise DataError(f"{root} is a LeRobot dataset of version {version}; this program reads v3")
        for key in ("fps", "features", "total_frames", "total_episodes", "data_path", "video_path"):
            info[key]  # a KeyError here names what is missing
    except FileNotFoundError as error:
        raise DataError(f"no LeRobot dataset at {root} (meta/info.json is missing)") from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(f"{path} is corrupt: {error!r}") from error
    return info


def camera_keys(info: dict[str, Any]) -> tuple[str, ...]:
    """Return the image keys of a dataset, in its own order."""
    return tuple(key for key in info["features"] if key.startswith(IMAGE_PREFIX))


def read_dataset_to_ram(
    root: Path | str,
    *,
    cameras: Sequence[str] | None = None,
    image_size: tuple[int, int] | None = None,
    progress: Progress | None = None,
) -> RamDataset:
    """Decode a dataset once into memory.

    Args:
        root: Folder of the dataset.
        cameras: LeRobot image keys to decode; all when None.
        image_size: (H, W) to scale pictures to while decoding (area average); as stored when None.
        progress: Called with (frames decoded, frames in all) now and then.

    Raises:
        DataError: the dataset is missing or corrupt, or a video holds another number of frames than the
            table has rows; the message names the file.
        UsageError: an unknown camera key.
    """
    root = Path(root)
    tables = _Tables.read(root)
    info, n = tables.info, len(tables.rows["index"])
    wanted = camera_keys(info) if cameras is None else tuple(cameras)
    images: dict[str, NDArray[np.uint8]] = {}
    for position, key in enumerate(wanted):
        height, width = _size(info, key, image_size)
        images[key] = np.empty((n, height, width, 3), dtype=np.uint8)
        for count, (row, frame) in enumerate(_frames(root, tables, key, (height, width)), start=1):
            images[key][row] = frame
            if progress is not None and (count % 1000 == 0 or count == n):
                progress(position * n + count, len(wanted) * n)
    return RamDataset(
        fps=float(info["fps"]),
        state=tables.rows[STATE],
        action=tables.rows[ACTION],
        images=images,
        episode_index=tables.rows["episode_index"],
        frame_index=tables.rows["frame_index"],
        episode_from=tables.starts,
        episode_to=tables.stops,
        state_names=tuple(info["features"][STATE]["names"]),
        action_names=tuple(info["features"][ACTION]["names"]),
    )


def iterate_frames(root: Path | str, camera: str) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yield (row, (H, W, 3) uint8 picture) of one camera, in the order of the rows, one in memory at a time.

    Raises as `read_dataset_to_ram`; a wrong number of frames shows at the end of a video.
    """
    root = Path(root)
    tables = _Tables.read(root)
    yield from _frames(root, tables, camera, _size(tables.info, camera, None))


@dataclass(frozen=True)
class _Tables:
    """The tables of a dataset, checked: info, numeric columns, episode table, first row and one past the last."""

    info: dict[str, Any]
    rows: dict[str, NDArray[Any]]
    episodes: Any
    starts: NDArray[np.int64]
    stops: NDArray[np.int64]

    @staticmethod
    def read(root: Path) -> _Tables:
        info = read_info(root)
        table = _read_parquet(sorted((root / "data").glob("chunk-*/file-*.parquet")), root)
        episodes = _read_parquet(sorted((root / "meta" / "episodes").glob("chunk-*/file-*.parquet")), root)
        try:
            rows = _rows(table)
            starts = np.asarray(episodes["dataset_from_index"].to_numpy(), dtype=np.int64)
            stops = np.asarray(episodes["dataset_to_index"].to_numpy(), dtype=np.int64)
        except (KeyError, ValueError) as error:
            raise DataError(f"{root}: a table lacks a column: {error}") from error
        _check_tables(root, info, rows, starts, stops)
        return _Tables(info, rows, episodes, starts, stops)


def _size(info: dict[str, Any], key: str, image_size: tuple[int, int] | None) -> tuple[int, int]:
    """Return (H, W) of a camera's pictures, or the size asked for."""
    if key not in camera_keys(info):
        raise unknown_name("camera", key, camera_keys(info))
    height, width = image_size or info["features"][key]["shape"][:2]
    return int(height), int(width)


def _frames(root: Path, tables: _Tables, key: str, size: tuple[int, int]) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    for name, slots in _frame_slots(tables, key).items():
        yield from zip(slots.tolist(), _decode(root / name, len(slots), size), strict=True)


def _read_parquet(paths: Sequence[Path], root: Path) -> Any:
    """Return the rows of parquet files as one arrow table."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not paths:
        raise DataError(f"{root} holds no parquet tables", remedy="convert the episodes again")
    tables = []
    for path in paths:
        try:
            tables.append(pq.read_table(path))
        except (pa.ArrowException, OSError) as error:
            raise DataError(f"{path} is truncated or corrupt: {error}", remedy="convert the episodes again") from error
    return pa.concat_tables(tables, promote_options="default")


def _rows(table: Any) -> dict[str, NDArray[Any]]:
    """Return the numeric columns of the data table as arrays."""
    rows: dict[str, NDArray[Any]] = {
        key: np.asarray(table[key].to_numpy(), dtype=np.int64) for key in ("index", "episode_index", "frame_index")
    }
    for key in (STATE, ACTION):
        rows[key] = np.stack(table[key].to_numpy()).astype(np.float32)
    return rows


def _check_tables(
    root: Path, info: dict[str, Any], rows: dict[str, NDArray[Any]], starts: NDArray[np.int64], stops: NDArray[np.int64]
) -> None:
    n = len(rows["index"])
    declared = (int(info["total_frames"]), int(info["total_episodes"]))
    if declared != (n, len(starts)):
        raise DataError(
            f"{root}: info.json declares {declared[0]} frames in {declared[1]} episodes, "
            f"the tables hold {n} in {len(starts)}",
            remedy="convert the episodes again",
        )
    expected = np.concatenate([np.arange(stop - start) for start, stop in zip(starts, stops, strict=True)])
    if not (np.array_equal(rows["index"], np.arange(n)) and np.array_equal(rows["frame_index"], expected)):
        raise DataError(f"{root}: row or frame indices do not run without gaps", remedy="convert the episodes again")


def _frame_slots(tables: _Tables, key: str) -> dict[str, NDArray[np.int64]]:
    """Map each video file of a camera to the rows that its frames belong to, in the order of the frames."""
    info, episodes = tables.info, tables.episodes
    chunk, file, begin = (
        episodes[f"videos/{key}/{name}"].to_numpy() for name in ("chunk_index", "file_index", "from_timestamp")
    )
    slots: dict[str, list[NDArray[np.int64]]] = {}
    order = np.lexsort((begin, file, chunk))
    for e in order:
        name = info["video_path"].format(video_key=key, chunk_index=int(chunk[e]), file_index=int(file[e]))
        parts = slots.setdefault(name, [])
        expected = sum(len(part) for part in parts)
        if round(float(begin[e]) * float(info["fps"])) != expected:
            raise DataError(f"{name}: episode {int(e)} does not begin at frame {expected} as the tables say")
        parts.append(np.arange(tables.starts[e], tables.stops[e]))
    return {name: np.concatenate(parts) for name, parts in slots.items()}


def _decode(path: Path, expected: int, size: tuple[int, int]) -> Iterator[NDArray[np.uint8]]:
    """Yield the `expected` pictures of a video as (H, W, 3) RGB, and refuse any other number of them."""
    import av

    count = 0
    try:
        with av.open(str(path)) as container:
            for frame in container.decode(video=0):
                count += 1
                if count <= expected:
                    yield frame.to_ndarray(format="rgb24", width=size[1], height=size[0], interpolation="AREA")
    except (av.FFmpegError, OSError) as error:
        raise DataError(f"{path} is missing or corrupt: {error}", remedy="convert the episodes again") from error
    if count != expected:
        raise DataError(
            f"{path} holds {count} frames; the table has {expected} rows for it", remedy="convert the episodes again"
        )
