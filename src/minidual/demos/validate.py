"""Holding one episode file against everything an episode must be: all faults at once, none raised.

`check_structure` asks whether the file can be used at all; `validate_episode` also asks whether what it shows
is sound. Both return `Problem`s with a stable name, the numbers, and a remedy.

==============================  ==================================================================
problem                         meaning
==============================  ==================================================================
``file_missing``                no such file
``file_corrupt``                truncated, not HDF5, or a checksum does not hold
``attributes_wrong``            an attribute is missing, broken, or of another schema version
``field_missing``               a required dataset is absent
``field_wrong``                 a dataset has another shape or type than the schema
``cameras_wrong``               cameras declared, stored and expected are not the same, in order
``too_short``                   fewer than two ticks
``not_finite``                  NaN or infinity
``timestamps_not_monotonic``    time stands still or runs backwards
``action_equals_qpos``          the reading was recorded as the command
``rate_wrong``                  the median interval is not 1/fps
``timestamps_jitter``           an interval strays by more than the limit
``out_of_sync``                 images and joints of a tick lie more than 20 ms apart
``outside_joint_limits``        joint order, units or limits are wrong
``images_black``                some frame is black
``images_constant``             some frame has a single colour
``images_frozen``               the picture never changes while the joints move
``cameras_identical``           two cameras show the same
``cameras_swapped``             a camera shows what another one shows in the other episodes
==============================  ==================================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from minidual.demos import cameras as camera_views
from minidual.demos import checks, schema
from minidual.demos.checks import Problem
from minidual.demos.episode import read_episode
from minidual.demos.schema import EpisodeMeta
from minidual.errors import DataError

_AGAIN = "record this episode again"


def validate_episode(
    path: Path | str,
    *,
    cameras: Sequence[str] | None = None,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    references: Mapping[str, NDArray[np.float32]] | None = None,
    max_sync_s: float = schema.MAX_SYNC_S,
    max_jitter_s: float | None = None,
) -> list[Problem]:
    """Return every fault of one episode file; an empty list means it is sound.

    Args:
        path: The HDF5 file.
        cameras: Camera names the file must hold, in this order; not checked when None.
        lower: (14,) lower joint limits, rad; with `upper`, or neither.
        upper: (14,) upper joint limits, rad.
        references: What each camera shows in other episodes (`minidual.demos.cameras.camera_references`).
        max_sync_s: Largest time between the joints and the pictures of a tick.
        max_jitter_s: Largest stray of an interval from 1/fps; half a period when None.
    """
    path = Path(path)
    problems = check_structure(path, cameras=cameras)
    if problems:
        return problems
    episode = read_episode(path)
    problems += checks.check_rate(episode.timestamps, episode.meta.fps, max_jitter_s)
    if episode.image_timestamps is not None:
        problems += checks.check_sync(episode.timestamps, episode.image_timestamps, max_sync_s)
    if lower is not None and upper is not None:
        problems += checks.check_limits(episode.qpos, np.asarray(lower, float), np.asarray(upper, float))
    problems += checks.check_images(episode.images, episode.qpos)
    if references is not None:
        problems += camera_views.check_swapped(episode.images, references)
    return problems


def check_structure(path: Path | str, *, cameras: Sequence[str] | None = None) -> list[Problem]:
    """Return the faults that make a file unusable; every array is read, so that bit rot shows."""
    path = Path(path)
    if not path.is_file():
        return [Problem("file_missing", f"no file {path}", "check the folder, or record again")]
    try:
        with h5py.File(path, "r") as file:
            try:
                meta = EpisodeMeta.from_attrs(file.attrs)
                ticks = int(file.attrs[schema.ATTR_NUM_TIMESTEPS])
            except DataError as error:
                return [Problem("attributes_wrong", f"{path.name}: {error.message}", _AGAIN)]
            arrays, problems = _numeric_fields(file, ticks)
            problems += _camera_faults(file, meta, ticks, cameras)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError) as error:
        return [Problem("file_corrupt", f"{path.name} is truncated or corrupt: {error}", _AGAIN)]
    if ticks < 2:
        problems.append(Problem("too_short", f"{ticks} ticks; an episode has at least 2", _AGAIN))
    if problems:
        return problems
    problems = checks.check_finite(arrays)
    problems += checks.check_monotonic(arrays[schema.TIMESTAMPS])
    if schema.IMAGE_TIMESTAMPS in arrays:
        problems += checks.check_monotonic(arrays[schema.IMAGE_TIMESTAMPS], schema.IMAGE_TIMESTAMPS)
    problems += checks.check_action_is_command(arrays[schema.QPOS], arrays[schema.ACTION])
    return problems


def _numeric_fields(file: h5py.File, ticks: int) -> tuple[dict[str, NDArray[np.float64]], list[Problem]]:
    """Return the arrays that fit the schema, and a fault for each that is absent or does not."""
    arrays: dict[str, NDArray[np.float64]] = {}
    problems: list[Problem] = []
    for field in schema.FIELDS:
        if field.key not in file:
            if field.required:
                problems.append(Problem("field_missing", f"{field.key} is missing", _AGAIN))
            continue
        dataset = file[field.key]
        expected = (ticks, *field.row_shape)
        if not isinstance(dataset, h5py.Dataset) or dataset.shape != expected or dataset.dtype.kind not in "fiu":
            found = f"{dataset.dtype} {dataset.shape}" if isinstance(dataset, h5py.Dataset) else "a group"
            problems.append(
                Problem("field_wrong", f"{field.key} is {found}; it must be {field.dtype} {expected}", _AGAIN)
            )
            continue
        arrays[field.key] = np.asarray(dataset[()], dtype=np.float64)
    return arrays, problems


def _camera_faults(file: h5py.File, meta: EpisodeMeta, ticks: int, expected: Sequence[str] | None) -> list[Problem]:
    """Return the faults of the set of cameras and of each picture array; reads every picture."""
    problems: list[Problem] = []
    stored = list(file[schema.IMAGES]) if schema.IMAGES in file else []
    remedy = "record with the cameras of the configuration, in its order"
    if sorted(stored) != sorted(meta.cameras):
        problems.append(
            Problem(
                "cameras_wrong", f"the file declares cameras {_list(meta.cameras)} and stores {_list(stored)}", remedy
            )
        )
    if expected is not None and tuple(expected) != meta.cameras:
        problems.append(
            Problem("cameras_wrong", f"cameras are {_list(meta.cameras)}; expected {_list(expected)}", remedy)
        )
    for camera in stored:
        key = schema.image_key(camera)
        dataset = file[key]
        shape = dataset.shape
        if dataset.dtype != np.uint8 or len(shape) != 4 or shape[0] != ticks or shape[3] != 3:
            problems.append(
                Problem("field_wrong", f"{key} is {dataset.dtype} {shape}; it must be uint8 ({ticks}, H, W, 3)", _AGAIN)
            )
            continue
        for start in range(0, ticks, 64):
            dataset[start : start + 64]
    return problems


def _list(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"
