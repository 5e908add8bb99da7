"""Read and validate a recorded episode; docs/data.md lists the faults."""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
from numpy.typing import DTypeLike, NDArray

from minidual.demos import checks, schema
from minidual.demos.faults import EpisodeFault
from minidual.errors import DataError
from minidual.robot.pair import Array, Robot

ARRAY_BYTES_MAX = 2**32
"""Limit of one array in memory."""
TICKS_MIN = 2

_ANY = -1
"""A length that is not checked."""


@dataclass(frozen=True)
class Episode:
    """One episode; see `minidual.demos.schema`."""

    meta: schema.EpisodeMeta
    images: dict[str, NDArray[np.uint8]]
    qpos: Array
    gripper: Array
    action: Array
    action_gripper: Array
    timestamps: Array
    qvel: Array | None = None
    image_timestamps: Array | None = None
    effort: Array | None = None
    path: Path | None = None
    signals: dict[str, Array] = field(default_factory=dict)
    """Recorded signals by name (`schema.SIGNALS`), and their `signal_timestamps`."""

    def __len__(self) -> int:
        return len(self.timestamps)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last tick [s]."""
        return float(self.timestamps[-1] - self.timestamps[0])


class Inspection(NamedTuple):
    """An episode, None if unreadable, and its faults."""

    episode: Episode | None
    faults: list[EpisodeFault]


def episode_paths(folder: Path | str) -> list[Path]:
    """Return a folder's finished episodes."""
    return sorted(Path(folder).glob("episode_[0-9]*.hdf5"))


def read_meta(path: Path | str) -> schema.EpisodeMeta:
    """Return the metadata; raises as `read_episode`."""
    path = Path(path)
    try:
        with _opened(path) as file:
            meta, _ = schema.EpisodeMeta.from_attrs(file.attrs)
            return meta
    except _UnreadableError as error:
        raise _refusal(path, error.fault) from error


def read_episode(path: Path | str, *, cameras: Sequence[str] | None = None) -> Episode:
    """Read one episode; `cameras` None loads all images.

    Raises:
        DataError: Missing, corrupt, or of another schema.
    """
    path = Path(path)
    episode, faults = _load(path, cameras)
    if episode is None:
        raise _refusal(path, faults[0])
    return episode


def inspect_episode(
    path: Path | str,
    *,
    cameras: Sequence[str] | None = None,
    size: tuple[int, int] | None = None,
    robot: Robot | None = None,
) -> Inspection:
    """Return an episode and every fault; None skips the check of `cameras`, `size` or `robot`.

    All arrays are read, to verify their checksums. Later checks need what the earlier ones check:
    the first group with a fault ends the inspection.
    """
    episode, faults = _load(Path(path), None)
    if episode is None:
        return Inspection(None, faults)
    faults += _format_faults(episode, cameras, size)
    if faults:
        return Inspection(episode, faults)
    faults += _order_faults(episode)
    if faults:
        return Inspection(episode, faults)
    faults += _content_faults(episode, robot)
    return Inspection(episode, faults)


def _format_faults(
    episode: Episode,
    cameras: Sequence[str] | None,
    size: tuple[int, int] | None,
) -> Iterator[EpisodeFault]:
    recorded = episode.meta.cameras
    if cameras is not None and tuple(cameras) != recorded:
        detail = f"cameras are {_list(recorded)}; expected {_list(cameras)}"
        yield EpisodeFault("cameras_wrong", detail)
    for camera, frames in episode.images.items():
        recorded_size = frames.shape[1:3]
        if size is not None and recorded_size != size:
            yield EpisodeFault(
                "images_size",
                f"camera '{camera}' has pictures of {recorded_size}; "
                f"expected {size} (height, width)",
            )
    if len(episode) < TICKS_MIN:
        detail = f"{len(episode)} ticks; an episode has at least {TICKS_MIN}"
        yield EpisodeFault("too_short", detail)


def _order_faults(episode: Episode) -> Iterator[EpisodeFault]:
    yield from checks.check_monotonic(episode.timestamps, "timestamps")
    if episode.image_timestamps is not None:
        yield from checks.check_monotonic(episode.image_timestamps, "image_timestamps")
    yield from checks.check_action_is_command(episode.qpos, episode.action)


def _content_faults(episode: Episode, robot: Robot | None) -> Iterator[EpisodeFault]:
    yield from checks.check_rate(episode.timestamps, episode.meta.fps)
    if episode.image_timestamps is not None:
        yield from checks.check_sync(episode.timestamps, episode.image_timestamps)
    if robot is not None:
        yield from checks.check_limits(episode.qpos, robot)
    yield from checks.check_images(episode.images, episode.qpos)


class _UnreadableError(Exception):
    """A file that cannot be opened or read at all."""

    def __init__(self, fault: EpisodeFault) -> None:
        super().__init__(str(fault))
        self.fault = fault


def _refusal(path: Path, fault: EpisodeFault) -> DataError:
    return DataError(f"{path}: {fault.detail}", remedy=fault.remedy)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """Open an episode; every error within becomes _UnreadableError."""
    if not path.is_file():
        raise _UnreadableError(EpisodeFault("file_missing", f"no episode file {path}"))
    try:
        with h5py.File(path, "r") as file:
            yield file
    except DataError as error:
        detail = f"{path.name}: {error.message}"
        raise _UnreadableError(EpisodeFault("attributes_wrong", detail)) from error
    except Exception as error:  # h5py raises anything
        detail = f"{path.name} is truncated or corrupt: {error}"
        raise _UnreadableError(EpisodeFault("file_corrupt", detail)) from error


def _load(path: Path, cameras: Sequence[str] | None) -> Inspection:
    """Return the episode, or why its file is not one."""
    try:
        with _opened(path) as file:
            return _Reader(file, path).read(cameras)
    except _UnreadableError as error:
        return Inspection(None, [error.fault])


class _Reader:
    """Reads an open file, collecting faults of its layout."""

    def __init__(self, file: h5py.File, path: Path) -> None:
        self._file = file
        self._path = path
        self._meta, self._ticks = schema.EpisodeMeta.from_attrs(file.attrs)
        self._faults: list[EpisodeFault] = []

    def read(self, cameras: Sequence[str] | None) -> Inspection:
        """Read the arrays and the images of `cameras`, None for all."""
        arrays = self._read_fields()
        images = self._read_images(cameras)
        if not self._faults:
            by_key = {f.key: arrays[f.name] for f in schema.FIELDS if f.name in arrays}
            self._faults += checks.check_finite(by_key)
        if self._faults:
            return Inspection(None, self._faults)
        episode = Episode(
            meta=self._meta,
            images=images,
            qpos=arrays["qpos"],
            gripper=arrays["gripper"],
            action=arrays["action"],
            action_gripper=arrays["action_gripper"],
            timestamps=arrays["timestamps"],
            qvel=arrays.get("qvel"),
            image_timestamps=arrays.get("image_timestamps"),
            effort=arrays.get("effort"),
            path=self._path,
            signals={
                name: arrays[name]
                for name in (*schema.SIGNALS, "signal_timestamps")
                if name in arrays
            },
        )
        return Inspection(episode, self._faults)

    def _read_fields(self) -> dict[str, Array]:
        joints_n = self._joints_n()
        arrays: dict[str, Array] = {}
        for column in schema.FIELDS:
            if column.key in self._file:
                shape = (self._ticks, *column.row_shape(joints_n))
                arrays[column.name] = self._array(column.key, shape, np.float64)
            elif column.required:
                self._faults.append(EpisodeFault("field_missing", f"{column.key} is missing"))
        return arrays

    def _joints_n(self) -> int:
        """Return the row length of the first two-dimensional array of joints, or 0."""
        for key in ("observations/qpos", "action"):
            dataset = self._file.get(key)
            if isinstance(dataset, h5py.Dataset) and dataset.ndim == 2:
                return dataset.shape[1]
        return 0

    def _read_images(self, cameras: Sequence[str] | None) -> dict[str, NDArray[np.uint8]]:
        declared = self._meta.cameras
        stored = list(self._file.get("observations/images", ()))
        if cameras is None:
            requested = declared
            if sorted(stored) != sorted(declared):
                detail = f"the file declares cameras {_list(declared)} and stores {_list(stored)}"
                self._faults.append(EpisodeFault("cameras_wrong", detail))
        else:
            requested = tuple(cameras)
            absent = [camera for camera in requested if camera not in stored]
            if absent:
                detail = f"no camera {_list(absent)}; there are {_list(declared)}"
                self._faults.append(EpisodeFault("cameras_wrong", detail))
        shape = (self._ticks, _ANY, _ANY, 3)
        images: dict[str, NDArray[np.uint8]] = {}
        for camera in declared:
            if camera in stored and camera in requested:
                images[camera] = self._array(schema.image_key(camera), shape, np.uint8)
        return images

    def _array[Item: np.generic](
        self,
        key: str,
        shape: tuple[int, ...],
        dtype: type[Item],
    ) -> NDArray[Item]:
        """Return a dataset; note a fault and return nothing if its shape or type is another."""
        dataset = self._file[key]
        nothing = np.empty(0, dtype)
        if not isinstance(dataset, h5py.Dataset):
            self._note_wrong(key, "a group", shape, dtype)
            return nothing
        if is_unsafe(dataset):
            self._faults.append(
                EpisodeFault(
                    "field_too_large",
                    f"{key} {dataset.shape} takes over {ARRAY_BYTES_MAX} bytes, "
                    "or lies in another file",
                ),
            )
            return nothing
        if not (np.can_cast(dataset.dtype, dtype) and _fits(dataset.shape, shape)):
            self._note_wrong(key, f"{dataset.dtype} {dataset.shape}", shape, dtype)
            return nothing
        return np.asarray(dataset[()], dtype=dtype)

    def _note_wrong(
        self,
        key: str,
        stored: str,
        shape: tuple[int, ...],
        dtype: DTypeLike,
    ) -> None:
        detail = f"{key} is {stored}; it must be {np.dtype(dtype)} {shape}"
        self._faults.append(EpisodeFault("field_wrong", detail))


def is_unsafe(dataset: h5py.Dataset) -> bool:
    """Return whether a dataset declares too much, or leads to another file.

    To be asked before anything is read: a sparse file may declare terabytes.
    """
    size = dataset.size * dataset.dtype.itemsize
    return bool(size > ARRAY_BYTES_MAX or dataset.external or dataset.is_virtual)


def _fits(shape: tuple[int, ...], expected: tuple[int, ...]) -> bool:
    if len(shape) != len(expected):
        return False
    pairs = zip(shape, expected, strict=True)
    return all(length in (_ANY, n) for n, length in pairs)


def _list(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"
