"""Read and validate a recorded episode; docs/data.md lists the faults."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from minidual.demos import checks, schema
from minidual.demos.checks import EpisodeFault
from minidual.errors import DataError
from minidual.robot.pair import Array, Robot

ARRAY_BYTES_MAX = 2**32
"""Limit of one array in memory."""


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
    path: Path | None = None

    def __len__(self) -> int:
        return len(self.timestamps)


def episode_paths(folder: Path | str) -> list[Path]:
    """Return a folder's finished episodes."""
    return sorted(Path(folder).glob("episode_[0-9]*.hdf5"))


def read_meta(path: Path | str) -> schema.EpisodeMeta:
    """Return the metadata; raises as `read_episode`."""
    return _sound(path, *_load(Path(path), (), fields=())).meta


def read_episode(path: Path | str, *, cameras: Sequence[str] | None = None) -> Episode:
    """Read one episode; `cameras` None loads all images.

    Raises:
        DataError: Missing, corrupt, or of another schema.
    """
    return _sound(path, *_load(Path(path), cameras))


def inspect_episode(
    path: Path | str,
    *,
    cameras: Sequence[str] | None = None,
    size: tuple[int, int] | None = None,
    robot: Robot | None = None,
) -> tuple[Episode | None, list[EpisodeFault]]:
    """Return an episode (None if unreadable) and every fault; None skips the check of `cameras`, `size` or `robot`.

    All arrays are read, to verify their checksums.
    """
    e, faults = _load(Path(path), None)
    if e is None:
        return None, faults
    if cameras is not None and tuple(cameras) != e.meta.cameras:
        detail = f"cameras are {_list(e.meta.cameras)}; expected {_list(cameras)}"
        faults.append(EpisodeFault("cameras_wrong", detail))
    for camera, frames in e.images.items():
        if size not in (None, frames.shape[1:3]):
            detail = f"camera '{camera}' has pictures of {frames.shape[1:3]}; expected {size} (height, width)"
            faults.append(EpisodeFault("images_size", detail))
    if len(e) < 2:
        faults.append(EpisodeFault("too_short", f"{len(e)} ticks; an episode has at least 2"))
    if faults:
        return e, faults
    for key, stamps in (("timestamps", e.timestamps), ("image_timestamps", e.image_timestamps)):
        faults += () if stamps is None else checks.check_monotonic(stamps, key)
    faults += checks.check_action_is_command(e.qpos, e.action)
    if faults:
        return e, faults
    faults += checks.check_rate(e.timestamps, e.meta.fps)
    if e.image_timestamps is not None:
        faults += checks.check_sync(e.timestamps, e.image_timestamps)
    if robot is not None:
        faults += checks.check_limits(e.qpos, robot)
    faults += checks.check_images(e.images, e.qpos)
    return e, faults


def _sound(path: Path | str, episode: Episode | None, faults: list[EpisodeFault]) -> Episode:
    if episode is None:
        raise DataError(f"{path}: {faults[0].detail}", remedy=faults[0].remedy)
    return episode


def _load(
    path: Path,
    cameras: Sequence[str] | None,
    fields: Sequence[schema.Field] = schema.FIELDS,
) -> tuple[Episode | None, list[EpisodeFault]]:
    if not path.is_file():
        return None, [EpisodeFault("file_missing", f"no episode file {path}")]
    arrays: dict[str, Array] = dict.fromkeys(
        (f.name for f in schema.FIELDS if f.required),
        np.empty(0),
    )
    faults: list[EpisodeFault] = []
    try:
        with h5py.File(path, "r") as file:
            meta, ticks = schema.EpisodeMeta.from_attrs(file.attrs)
            found = (file.get(key) for key in ("observations/qpos", "action"))
            joints_n = next(
                (f.shape[1] for f in found if isinstance(f, h5py.Dataset) and f.ndim == 2),
                0,
            )
            for field in fields:
                if field.key in file:
                    expected = (ticks, *field.row_shape(joints_n))
                    arrays[field.name] = _array(file, field.key, expected, np.float64, faults)
                elif field.required:
                    faults.append(EpisodeFault("field_missing", f"{field.key} is missing"))
            images = _images(file, meta, ticks, cameras, faults)
            faults += (
                ()
                if faults
                else checks.check_finite(
                    {f.key: arrays[f.name] for f in fields if f.name in arrays},
                )
            )
    except DataError as error:
        return None, [EpisodeFault("attributes_wrong", f"{path.name}: {error.message}")]
    except Exception as error:  # h5py raises anything
        return None, [EpisodeFault("file_corrupt", f"{path.name} is truncated or corrupt: {error}")]
    return (None if faults else Episode(meta, images, path=path, **arrays)), faults


def _images(
    file: h5py.File,
    meta: schema.EpisodeMeta,
    ticks: int,
    cameras: Sequence[str] | None,
    faults: list[EpisodeFault],
) -> dict[str, NDArray[np.uint8]]:
    stored = list(file.get("observations/images", ()))
    if cameras is None and sorted(stored) != sorted(meta.cameras):
        detail = f"the file declares cameras {_list(meta.cameras)} and stores {_list(stored)}"
        faults.append(EpisodeFault("cameras_wrong", detail))
    if absent := [camera for camera in cameras or () if camera not in stored]:
        faults.append(
            EpisodeFault(
                "cameras_wrong",
                f"no camera {_list(absent)}; there are {_list(meta.cameras)}",
            ),
        )
    wanted = [
        camera
        for camera in meta.cameras
        if camera in stored and (cameras is None or camera in cameras)
    ]
    return {
        c: _array(file, schema.image_key(c), (ticks, -1, -1, 3), np.uint8, faults) for c in wanted
    }


def _array(
    file: h5py.File,
    key: str,
    shape: tuple[int, ...],
    dtype: type,
    faults: list[EpisodeFault],
) -> NDArray[Any]:
    """Return a dataset; append a fault if its shape (-1: any length) or type is another."""
    found: Any = file[key]
    is_array = isinstance(found, h5py.Dataset)
    # Checked before anything is read: a sparse file declares terabytes, and a link leads to another file.
    if is_array and (
        found.size * found.dtype.itemsize > ARRAY_BYTES_MAX or found.external or found.is_virtual
    ):
        what = f"{key} {found.shape} takes over {ARRAY_BYTES_MAX} bytes, or lies in another file"
        faults.append(EpisodeFault("field_too_large", what))
        return np.empty(0, dtype)
    alike = is_array and np.can_cast(found.dtype, dtype) and len(found.shape) == len(shape)
    if alike and all(wanted in (-1, n) for n, wanted in zip(found.shape, shape, strict=True)):
        return np.asarray(found[()], dtype=dtype)
    shown = f"{found.dtype} {found.shape}" if is_array else "a group"
    faults.append(
        EpisodeFault("field_wrong", f"{key} is {shown}; it must be {np.dtype(dtype)} {shape}"),
    )
    return np.empty(0, dtype)


def _list(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"
