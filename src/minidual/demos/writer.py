"""Record one episode; its file is whole or absent.

Images are written tick by tick, compressed with gzip 1, one frame per chunk; numeric arrays at the
end, with checksums.
"""

import contextlib
import dataclasses
import io
from collections.abc import Buffer, Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from minidual import durable
from minidual.demos import checks, schema
from minidual.errors import DataError, UsageError, unknown_name

Row = NDArray[np.float64]


class _Disk(io.FileIO):
    """A file that keeps the first error of a write in `error`.

    HDF5 crashes the process after a failed write, so every write reports success.
    """

    error: OSError | None = None

    def write(self, data: Buffer, /) -> int:
        remaining = memoryview(data).cast("B")
        size = len(remaining)
        try:
            while remaining and self.error is None:
                written = super().write(remaining) or 0
                remaining = remaining[written:]
        except OSError as error:
            self.error = error
        return size

    def truncate(self, size: int | None = None, /) -> int:
        try:
            return super().truncate(size)
        except OSError as error:
            if self.error is None:
                self.error = error
            return size or 0


class EpisodeWriter(contextlib.AbstractContextManager["EpisodeWriter"]):
    """Records one episode; `path` exists after `finish` and `publish`.

    Leaving the context discards what is not published.

    Raises:
        UsageError: The file exists.
    """

    def __init__(self, path: Path | str, meta: schema.EpisodeMeta) -> None:
        self.path = Path(path)
        self.meta = meta
        if self.path.exists():
            remedy = "choose another folder, or move the old recording away"
            raise UsageError(f"{self.path} exists already", remedy=remedy)
        durable.make_folder(self.path.parent)
        self._partial = durable.partial_path(self.path)
        self._rows: dict[str, list[Row]] = {field.name: [] for field in schema.FIELDS}
        self._images: dict[str, h5py.Dataset] = {}
        self._closed = False
        self._disk = _Disk(self._partial, "w+")
        self._file = h5py.File(self._disk, "w")

    def __exit__(self, *error: object) -> None:
        self.abort()

    def __len__(self) -> int:
        return len(self._rows["timestamps"])

    def append(self, *, images: Mapping[str, NDArray[np.uint8]], **values: Any) -> None:
        """Add one tick, copying arrays; `values` by field of the schema.

        The first tick fixes n. `images` must hold exactly `meta`'s cameras. Optional values come on
        every tick or none.

        Raises:
            DataError: Wrong shape or value, or a disk error.
            UsageError: Unknown field.
        """
        if self._closed:
            raise DataError(f"{self.path.name} is closed; a tick came after finish or abort")
        for name in values.keys() - self._rows.keys():
            raise unknown_name("field", name, self._rows)
        row = self._checked_row(values)
        self._check_images(images)
        with self._writing():
            self._write_images(images)
        for name, value in row.items():
            self._rows[name].append(value)

    def finish(self, *, success: bool, extra: Mapping[str, Any] | None = None) -> Path:
        """Check and close the temporary file; return its path.

        `extra` is added to that of the metadata.

        Raises:
            DataError: Under two ticks, actions equal readings, or a disk error; no file is left.
        """
        try:
            self._check_complete()
            merged = {**self.meta.extra, **(extra or {})}
            self.meta = dataclasses.replace(self.meta, success=bool(success), extra=merged)
            with self._writing():
                self._write_fields()
                self._file.attrs.update(self.meta.to_attrs(len(self)))
                self._file.close()
                self._disk.close()
        except BaseException:
            self.abort()
            raise
        self._closed = True
        return self._partial

    def publish(self, path: Path | None = None) -> Path:
        """Give the finished file its name (default `path`), durably; return it."""
        if path is None:
            path = self.path
        durable.make_folder(path.parent)
        with self._writing():
            durable.publish(self._partial, path)
        return path

    def abort(self) -> None:
        """Discard the file unless it was published."""
        self._closed = True
        with contextlib.suppress(OSError, RuntimeError):
            self._file.close()
        self._disk.close()
        durable.remove(self._partial)

    def _checked_row(self, values: Mapping[str, Any]) -> dict[str, Row]:
        """Return the arrays of the next tick by field."""
        tick = len(self)
        joints_n = len(self._rows["qpos"][0]) if tick else np.size(values.get("qpos", ()))
        row: dict[str, Row] = {}
        for field in schema.FIELDS:
            value = _checked_value(field, values.get(field.name), joints_n, tick)
            if value is not None:
                row[field.name] = value
        for field in schema.FIELDS:
            given_before = bool(self._rows[field.name])
            if tick and (field.name in row) != given_before:
                raise DataError(f"{field.key} at tick {tick}: give it on every tick or on none")
        now = row["timestamps"]
        if tick and not now > self._rows["timestamps"][-1]:
            raise DataError(
                f"timestamps_not_monotonic: tick {tick} is stamped {now:.6f} s, "
                "not after the one before",
                remedy="stamp ticks with a monotonic clock",
            )
        return row

    def _check_images(self, images: Mapping[str, NDArray[np.uint8]]) -> None:
        tick = len(self)
        if set(images) != set(self.meta.cameras):
            brought = ", ".join(sorted(images)) or "none"
            declared = ", ".join(self.meta.cameras) or "none"
            raise DataError(
                f"tick {tick} brings cameras {brought}; the episode declares {declared}"
            )
        for camera, image in images.items():
            key = schema.image_key(camera)
            if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
                raise DataError(
                    f"{key} at tick {tick} is {image.dtype} {image.shape}; "
                    "it must be uint8 (H, W, 3)",
                )
            if tick:
                shape = self._images[camera].shape[1:]
                if image.shape != shape:
                    raise DataError(f"{key} changes from {shape} to {image.shape} at tick {tick}")

    def _check_complete(self) -> None:
        """Raise DataError if the ticks are no episode."""
        name = self.path.name
        if self._closed:
            raise DataError(f"{name} is closed already")
        if len(self) < 2:
            detail = f"too_short: {len(self)} ticks, at least 2"
            raise DataError(f"episode {name} is not written: {detail}")
        qpos = np.stack(self._rows["qpos"])
        action = np.stack(self._rows["action"])
        for fault in checks.check_action_is_command(qpos, action):
            raise DataError(f"episode {name} is not written: {fault}", remedy=fault.remedy)

    def _write_images(self, images: Mapping[str, NDArray[np.uint8]]) -> None:
        tick = len(self)
        for camera, image in images.items():
            if camera not in self._images:
                self._images[camera] = self._file.create_dataset(
                    schema.image_key(camera),
                    (0, *image.shape),
                    "uint8",
                    maxshape=(None, *image.shape),
                    chunks=(1, *image.shape),
                    compression="gzip",
                    compression_opts=1,
                )
            dataset = self._images[camera]
            dataset.resize(tick + 1, axis=0)
            dataset[tick] = image

    def _write_fields(self) -> None:
        for field in schema.FIELDS:
            rows = self._rows[field.name]
            if rows:
                self._file.create_dataset(
                    field.key,
                    data=np.stack(rows),
                    dtype="float64",
                    fletcher32=True,
                )

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Discard the file and raise the error of the disk if one occurs within."""
        try:
            yield
            if self._disk.error:
                raise self._disk.error
        except (OSError, RuntimeError) as error:
            self.abort()
            remedy = "check the disk or choose another folder; nothing half-written was left"
            raise durable.unwritten(error, self.path, remedy) from error


def _checked_value(
    field: schema.Field,
    value: ArrayLike | None,
    joints_n: int,
    tick: int,
) -> Row | None:
    """Return a copy of a field's value at a tick, None if it is absent and optional."""
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
