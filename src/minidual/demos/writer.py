"""Recording one episode so that its file is whole or absent.

Ticks are gathered in memory up to a budget and pictures spilled to a temporary file beyond it, so the
recording loop does not wait for the disk in ordinary episodes. Pictures are stored with gzip level 1, one
frame a chunk: 0.35 ms for a rendered 96x128 frame and half the size; lzf takes 0.16 ms but only h5py reads it.
Numeric fields carry a checksum (fletcher32), pictures that of gzip, so bit rot is noticed on reading.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from minidual import durable
from minidual.demos import checks, schema
from minidual.demos.schema import EpisodeMeta
from minidual.errors import DataError, UsageError

IMAGE_FILTERS: dict[str, Any] = {"compression": "gzip", "compression_opts": 1}
IMAGE_BUFFER_BYTES = 256 * 2**20


class EpisodeWriter:
    """Records one episode to `path`; nothing stands under that name before `commit` has succeeded.

    Use it as a context manager: leaving the block without `commit` (an exception, Ctrl-C, a rejected
    episode) removes what was written. A killed process leaves only a temporary name that
    `EpisodeStore.repair` removes.

    Args:
        path: The file to make, ending in ``.hdf5``; its folder is made if missing.
        meta: What is recorded; `success` and `extra` can still be set by `commit`.
        overwrite: Replace an existing file; without it an existing file is refused.
        image_buffer_bytes: Pictures kept in memory before they are written out.

    Raises:
        UsageError: the file exists and `overwrite` is false.
        DataError: a tick has wrong shapes or values (`append`), the episode as a whole is at fault or the
            disk does not take it (`commit`).
    """

    def __init__(
        self,
        path: Path | str,
        meta: EpisodeMeta,
        *,
        overwrite: bool = False,
        image_buffer_bytes: int = IMAGE_BUFFER_BYTES,
    ) -> None:
        self.path = Path(path)
        self.meta = meta
        self._overwrite = overwrite
        self._image_buffer_bytes = image_buffer_bytes
        self._refuse_existing()
        durable.make_folder(self.path.parent)
        self._partial = durable.partial_path(self.path)
        self._rows: dict[str, list[NDArray[Any]]] = {field.key: [] for field in schema.FIELDS}
        self._images: dict[str, list[NDArray[np.uint8]]] = {camera: [] for camera in meta.cameras}
        self._image_shape: dict[str, tuple[int, ...]] = {}
        self._buffered_bytes = 0
        self._file: h5py.File | None = None
        self._closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.abort()

    def __len__(self) -> int:
        return len(self._rows[schema.TIMESTAMPS])

    def append(
        self,
        *,
        qpos: ArrayLike,
        action: ArrayLike,
        gripper: ArrayLike,
        action_gripper: ArrayLike,
        timestamp: float,
        images: Mapping[str, NDArray[np.uint8]],
        qvel: ArrayLike | None = None,
        image_timestamp: float | None = None,
    ) -> None:
        """Add one tick; the arrays are copied.

        Args:
            qpos: (14,) measured joint positions, rad, left then right.
            action: (14,) joint targets commanded at this tick, rad.
            gripper: (2,) measured opening, left then right.
            action_gripper: (2,) commanded gripper targets.
            timestamp: Time of the joint reading, monotonic seconds.
            images: (H, W, 3) uint8 for exactly the cameras of `meta`.
            qvel: (14,) rad/s; on every tick or on none.
            image_timestamp: Time of the pictures where it differs, s; on every tick or on none.

        Raises:
            DataError: naming the field and the tick.
        """
        if self._closed:
            raise DataError(f"{self.path.name} is closed; a tick came after commit or abort")
        tick = len(self)
        given: dict[str, ArrayLike | None] = {
            schema.QPOS: qpos,
            schema.QVEL: qvel,
            schema.GRIPPER: gripper,
            schema.ACTION: action,
            schema.ACTION_GRIPPER: action_gripper,
            schema.TIMESTAMPS: timestamp,
            schema.IMAGE_TIMESTAMPS: image_timestamp,
        }
        row = {field.key: _checked_row(field, given[field.key], tick) for field in schema.FIELDS}
        for field in schema.FIELDS:
            if not field.required and tick > 0 and (row[field.key] is None) != (not self._rows[field.key]):
                raise DataError(f"{field.key} at tick {tick}: give it on every tick or on none")
        self._check_images(images, tick)
        if tick > 0 and not float(timestamp) > float(self._rows[schema.TIMESTAMPS][-1]):
            raise DataError(
                f"timestamps_not_monotonic: tick {tick} is stamped {timestamp:.6f} s, not after the one before",
                remedy="stamp ticks with a monotonic clock",
            )
        for key, value in row.items():
            if value is not None:
                self._rows[key].append(value)
        for camera in self.meta.cameras:
            self._images[camera].append(np.array(images[camera], dtype=np.uint8, copy=True))
            self._buffered_bytes += images[camera].nbytes
        if self._buffered_bytes > self._image_buffer_bytes:
            with self._writing():
                self._spill()

    def commit(self, *, success: bool, extra: Mapping[str, Any] | None = None) -> Path:
        """Check the episode as a whole, write it durably, give it its name, and return the path.

        Raises:
            DataError: fewer than two ticks, or a fault found by `minidual.demos.checks`; the temporary file
                is removed and nothing stands under the name.
        """
        if self._closed:
            raise DataError(f"{self.path.name} is closed already")
        try:
            self._refuse_existing()
            arrays = {key: np.stack(rows) for key, rows in self._rows.items() if rows}
            problems = _hard_problems(arrays, len(self))
            if problems:
                raise DataError(f"episode {self.path.name} is not written: {problems[0]}", remedy=problems[0].remedy)
            merged = {**self.meta.extra, **(extra or {})}
            self.meta = dataclasses.replace(self.meta, success=bool(success), extra=merged)
            with self._writing():
                self._spill()
                file = self._open()
                for key, values in arrays.items():
                    file.create_dataset(key, data=values, dtype="float64", fletcher32=True)
                for name, value in self.meta.to_attrs(len(self)).items():
                    file.attrs[name] = value
                file.close()
                self._file = None
                durable.publish(self._partial, self.path)
        finally:
            self.abort()
        return self.path

    def abort(self) -> None:
        """Drop the episode and its temporary file. Harmless after `commit`, and when called again."""
        self._closed = True
        if self._file is not None:
            # On a full disk closing fails as well; the file is about to be removed either way.
            with contextlib.suppress(OSError, RuntimeError):
                self._file.close()
            self._file = None
        durable.remove(self._partial)
        self._images = {camera: [] for camera in self.meta.cameras}

    def _refuse_existing(self) -> None:
        if self.path.exists() and not self._overwrite:
            raise UsageError(
                f"{self.path} exists already", remedy="choose another folder, or move the old recording away"
            )

    def _check_images(self, images: Mapping[str, NDArray[np.uint8]], tick: int) -> None:
        if set(images) != set(self.meta.cameras):
            raise DataError(
                f"tick {tick} brings cameras {', '.join(sorted(images)) or 'none'}; "
                f"the episode declares {', '.join(self.meta.cameras) or 'none'}"
            )
        for camera, image in images.items():
            if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
                raise DataError(
                    f"{schema.image_key(camera)} at tick {tick} is {image.dtype} {image.shape}; "
                    "it must be uint8 (H, W, 3)"
                )
            shape = self._image_shape.setdefault(camera, image.shape)
            if image.shape != shape:
                raise DataError(f"{schema.image_key(camera)} changes from {shape} to {image.shape} at tick {tick}")

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Turn a refusal of the disk into a DataError, with nothing half-written left."""
        try:
            yield
        except (OSError, RuntimeError) as error:
            self.abort()
            raise DataError(
                f"{self.path} could not be written: {error}",
                remedy="free space on the disk or choose another folder; nothing half-written was left",
            ) from error

    def _open(self) -> h5py.File:
        if self._file is None:
            self._file = h5py.File(self._partial, "w")
        return self._file

    def _spill(self) -> None:
        """Write the buffered pictures to the temporary file, after those already there."""
        file = self._open()
        for camera, frames in self._images.items():
            if not frames:
                continue
            key, block = schema.image_key(camera), np.stack(frames)
            if key not in file:
                tail = block.shape[1:]
                file.create_dataset(
                    key, shape=(0, *tail), maxshape=(None, *tail), dtype="uint8", chunks=(1, *tail), **IMAGE_FILTERS
                )
            dataset = file[key]
            start = dataset.shape[0]
            dataset.resize(start + len(block), axis=0)
            dataset[start:] = block
            frames.clear()
        self._buffered_bytes = 0


def _hard_problems(arrays: Mapping[str, NDArray[np.float64]], ticks: int) -> list[checks.Problem]:
    """Return the faults for which no file is written at all."""
    if ticks < 2:
        return [checks.Problem("too_short", f"{ticks} ticks; an episode has at least 2", "record longer")]
    problems = checks.check_monotonic(arrays[schema.TIMESTAMPS])
    problems += checks.check_action_is_command(arrays[schema.QPOS], arrays[schema.ACTION])
    return problems


def _checked_row(field: schema.Field, value: ArrayLike | None, tick: int) -> NDArray[np.float64] | None:
    """Return one tick of one field as float64, or raise DataError naming both."""
    if value is None:
        if field.required:
            raise DataError(f"{field.key} is missing at tick {tick}")
        return None
    try:
        row = np.array(value, dtype=np.float64, copy=True)
    except (TypeError, ValueError) as error:
        raise DataError(f"{field.key} at tick {tick} is not numeric: {error}") from error
    if row.shape != field.row_shape:
        raise DataError(f"{field.key} at tick {tick} has shape {row.shape}; it must be {field.row_shape}")
    if not np.all(np.isfinite(row)):
        raise DataError(
            f"{field.key} at tick {tick} is NaN or infinite",
            remedy="stop the recording; look for an unstable simulation or a lost sensor",
        )
    return row
