"""One recorded episode in memory, and reading it back from its file with named faults.

Writing lives in `minidual.demos.writer`; `EpisodeWriter` is offered here too, so that one import serves both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from minidual.demos import schema
from minidual.demos.schema import EpisodeMeta
from minidual.demos.writer import EpisodeWriter
from minidual.errors import DataError

__all__ = ["Episode", "EpisodeWriter", "read_episode", "read_meta"]


@dataclass(frozen=True)
class Episode:
    """One episode in memory; T ticks, shapes and units as in `minidual.demos.schema`."""

    meta: EpisodeMeta
    qpos: NDArray[np.float64]
    gripper: NDArray[np.float64]
    action: NDArray[np.float64]
    action_gripper: NDArray[np.float64]
    timestamps: NDArray[np.float64]
    images: dict[str, NDArray[np.uint8]]
    qvel: NDArray[np.float64] | None = None
    image_timestamps: NDArray[np.float64] | None = None
    path: Path | None = None

    def __len__(self) -> int:
        return len(self.timestamps)

    @property
    def duration_s(self) -> float:
        """Time from the first tick to the last, seconds."""
        return float(self.timestamps[-1] - self.timestamps[0])


def read_episode(path: Path | str, *, cameras: Sequence[str] | None = None) -> Episode:
    """Read one episode.

    Args:
        path: The HDF5 file.
        cameras: Which pictures to load; all when None, none when empty.

    Raises:
        DataError: the file is missing, truncated, corrupt, of another schema version, or its arrays do not
            have the declared shapes; the message names the file.
    """
    path = Path(path)
    if not path.is_file():
        raise DataError(f"no episode file {path}", remedy="check the folder, or record with 'minidual teleop-record'")
    try:
        with h5py.File(path, "r") as file:
            meta = EpisodeMeta.from_attrs(file.attrs)
            n = int(file.attrs[schema.ATTR_NUM_TIMESTEPS])
            wanted = meta.cameras if cameras is None else tuple(cameras)
            absent = [camera for camera in wanted if schema.image_key(camera) not in file]
            if absent:
                raise DataError(f"no camera {', '.join(absent)}; there are {', '.join(meta.cameras) or 'none'}")
            arrays = {field.key: _read_field(file, field, n) for field in schema.FIELDS}
            images = {camera: _read_images(file, camera, n) for camera in wanted}
    except DataError as error:
        raise DataError(f"{path}: {error.message}", remedy=error.remedy) from error
    except (OSError, KeyError, RuntimeError, ValueError, TypeError, AttributeError) as error:
        raise DataError(
            f"{path} is truncated or corrupt: {error}",
            remedy="record this episode again; EpisodeStore.repair sets the broken file aside",
        ) from error
    return Episode(
        meta=meta,
        qpos=_present(arrays[schema.QPOS]),
        gripper=_present(arrays[schema.GRIPPER]),
        action=_present(arrays[schema.ACTION]),
        action_gripper=_present(arrays[schema.ACTION_GRIPPER]),
        timestamps=_present(arrays[schema.TIMESTAMPS]),
        images=images,
        qvel=arrays[schema.QVEL],
        image_timestamps=arrays[schema.IMAGE_TIMESTAMPS],
        path=path,
    )


def read_meta(path: Path | str) -> tuple[EpisodeMeta, int]:
    """Return what an episode is and its number of ticks, without loading arrays. Raises as `read_episode`."""
    path = Path(path)
    try:
        with h5py.File(path, "r") as file:
            return EpisodeMeta.from_attrs(file.attrs), int(file.attrs[schema.ATTR_NUM_TIMESTEPS])
    except DataError as error:
        raise DataError(f"{path}: {error.message}", remedy=error.remedy) from error
    except (OSError, KeyError, RuntimeError, ValueError, TypeError) as error:
        raise DataError(
            f"{path} is missing, truncated or corrupt: {error}",
            remedy="record this episode again; EpisodeStore.repair sets the broken file aside",
        ) from error


def _read_field(file: h5py.File, field: schema.Field, n: int) -> NDArray[np.float64] | None:
    if field.key not in file:
        if field.required:
            raise DataError(f"field {field.key} is missing")
        return None
    values = np.asarray(file[field.key][()])
    if values.shape != (n, *field.row_shape):
        raise DataError(f"field {field.key} has shape {values.shape}; it must be {(n, *field.row_shape)}")
    if values.dtype.kind not in "fiu":
        raise DataError(f"field {field.key} is {values.dtype}; it must be {field.dtype}")
    return values.astype(np.float64)


def _read_images(file: h5py.File, camera: str, n: int) -> NDArray[np.uint8]:
    key = schema.image_key(camera)
    dataset = file[key]
    if dataset.dtype != np.uint8 or dataset.ndim != 4 or dataset.shape[0] != n or dataset.shape[3] != 3:
        raise DataError(f"field {key} is {dataset.dtype} {dataset.shape}; it must be uint8 ({n}, H, W, 3)")
    return np.asarray(dataset[()], dtype=np.uint8)


def _present(values: NDArray[np.float64] | None) -> NDArray[np.float64]:
    if values is None:  # required fields were refused by _read_field
        raise DataError("a required field is missing")
    return values
