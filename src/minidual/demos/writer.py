"""Record one episode; its file is whole or absent.

Images beyond a budget spill to a temporary file, with gzip 1 and one frame per chunk: 0.35 ms per 96x128 frame, half
the size (lzf: 0.16 ms, but only h5py reads it). Checksums detect bit rot.
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

IMAGE_BUFFER_BYTES = 256 * 2**20


class EpisodeWriter:
    """Records one episode; `path` exists only after `commit`.

    Leaving the context removes partial files. `commit` updates success and extra of `meta`.

    Raises:
        UsageError: The file exists.
    """

    def __init__(self, path: Path | str, meta: EpisodeMeta, *, image_buffer_bytes: int = IMAGE_BUFFER_BYTES) -> None:
        self.path, self.meta = Path(path), meta
        self._image_buffer_bytes = image_buffer_bytes
        self._refuse_existing()
        durable.make_folder(self.path.parent)
        self._partial = durable.partial_path(self.path)
        self._rows: dict[str, list[NDArray[np.float64]]] = {field.name: [] for field in schema.FIELDS}
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
        return len(self._rows["timestamps"])

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
        """Add one tick, copying arrays.

        Shapes and units as in the schema; the first tick fixes n. `images` must hold exactly `meta`'s cameras.
        Optional values come on every tick or none.

        Raises:
            DataError: Wrong shape or value, or a disk error.
        """
        if self._closed:
            raise DataError(f"{self.path.name} is closed; a tick came after commit or abort")
        tick, times = len(self), self._rows["timestamps"]
        given = (qpos, qvel, gripper, action, action_gripper, timestamp, image_timestamp)
        joints_n = len(self._rows["qpos"][0]) if tick else np.size(qpos)
        row = {f.name: _row(f, value, joints_n, tick) for f, value in zip(schema.FIELDS, given, strict=True)}
        for field in schema.FIELDS:
            if tick and (row[field.name] is None) == bool(self._rows[field.name]):
                raise DataError(f"{field.key} at tick {tick}: give it on every tick or on none")
        self._check_images(images, tick)
        if tick and not timestamp > times[-1]:
            raise DataError(
                f"timestamps_not_monotonic: tick {tick} is stamped {timestamp:.6f} s, not after the one before",
                remedy="stamp ticks with a monotonic clock",
            )
        for name, value in row.items():
            if value is not None:
                self._rows[name].append(value)
        for camera in self.meta.cameras:
            self._images[camera].append(images[camera].copy())
            self._buffered_bytes += images[camera].nbytes
        if self._buffered_bytes > self._image_buffer_bytes:
            with self._writing():
                self._spill()

    def commit(self, *, success: bool, extra: Mapping[str, Any] | None = None) -> Path:
        """Check, write durably, and return the path.

        Raises:
            UsageError: The file exists by now.
            DataError: Under two ticks, actions equal readings, or a disk error; no file is left.
        """
        if self._closed:
            raise DataError(f"{self.path.name} is closed already")
        try:
            self._refuse_existing()
            if len(self) < 2:
                raise DataError(f"episode {self.path.name} is not written: too_short: {len(self)} ticks, at least 2")
            arrays = {field.key: np.stack(rows) for field in schema.FIELDS if (rows := self._rows[field.name])}
            for problem in checks.check_action_is_command(np.stack(self._rows["qpos"]), np.stack(self._rows["action"])):
                raise DataError(f"episode {self.path.name} is not written: {problem}", remedy=problem.remedy)
            merged = {**self.meta.extra, **(extra or {})}
            self.meta = dataclasses.replace(self.meta, success=bool(success), extra=merged)
            with self._writing():
                file = self._spill()
                for key, values in arrays.items():
                    file.create_dataset(key, data=values, dtype="float64", fletcher32=True)
                for name, value in self.meta.to_attrs(len(self)).items():
                    file.attrs[name] = value
                file.close()
                durable.publish(self._partial, self.path)
        finally:
            self.abort()
        return self.path

    def abort(self) -> None:
        """Discard what is not committed."""
        self._closed = True
        if self._file is not None:
            # Closing fails on a full disk too; the file is removed next anyway.
            with contextlib.suppress(OSError, RuntimeError):
                self._file.close()
            self._file = None
        durable.remove(self._partial)
        self._images.clear()

    def _refuse_existing(self) -> None:
        if self.path.exists():
            remedy = "choose another folder, or move the old recording away"
            raise UsageError(f"{self.path} exists already", remedy=remedy)

    def _check_images(self, images: Mapping[str, NDArray[np.uint8]], tick: int) -> None:
        if set(images) != set(self.meta.cameras):
            raise DataError(
                f"tick {tick} brings cameras {', '.join(sorted(images)) or 'none'}; "
                f"the episode declares {', '.join(self.meta.cameras) or 'none'}"
            )
        for camera, image in images.items():
            key = schema.image_key(camera)
            if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
                raise DataError(f"{key} at tick {tick} is {image.dtype} {image.shape}; it must be uint8 (H, W, 3)")
            shape = self._image_shape.setdefault(camera, image.shape)
            if image.shape != shape:
                raise DataError(f"{key} changes from {shape} to {image.shape} at tick {tick}")

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, RuntimeError) as error:
            self.abort()
            remedy = "free space on the disk or choose another folder; nothing half-written was left"
            raise DataError(f"{self.path} could not be written: {error}", remedy=remedy) from error

    def _spill(self) -> h5py.File:
        file = self._file = self._file or h5py.File(self._partial, "w")
        for camera, frames in self._images.items():
            if not frames:
                continue
            key, block = schema.image_key(camera), np.stack(frames)
            if key not in file:
                file.create_dataset(
                    key,
                    shape=(0, *block.shape[1:]),
                    maxshape=(None, *block.shape[1:]),
                    dtype="uint8",
                    chunks=(1, *block.shape[1:]),
                    compression="gzip",
                    compression_opts=1,
                )
            dataset = file[key]
            assert isinstance(dataset, h5py.Dataset)
            start = len(dataset)
            dataset.resize(start + len(block), axis=0)
            dataset[start:] = block
            frames.clear()
        self._buffered_bytes = 0
        return file


def _row(field: schema.Field, value: ArrayLike | None, joints_n: int, tick: int) -> NDArray[np.float64] | None:
    if value is None:
        if field.required:
            raise DataError(f"{field.key} is missing at tick {tick}")
        return None
    try:
        row = np.array(value, dtype=np.float64, copy=True)
    except (TypeError, ValueError) as error:
        raise DataError(f"{field.key} at tick {tick} is not numeric: {error}") from error
    expected = field.row_shape(joints_n)
    if row.shape != expected:
        raise DataError(f"{field.key} at tick {tick} has shape {row.shape}; it must be {expected}")
    if not np.all(np.isfinite(row)):
        remedy = "stop the recording; look for an unstable simulation or a lost sensor"
        raise DataError(f"{field.key} at tick {tick} is NaN or infinite", remedy=remedy)
    return row
