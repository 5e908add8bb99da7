"""Read and validate a recorded episode.

==============================  ==================================================================
problem                         meaning
==============================  ==================================================================
``file_missing``                no such file
``file_corrupt``                truncated, not HDF5, or checksum mismatch
``attributes_wrong``            missing, invalid, or another schema version
``field_missing``               a required array is absent
``field_wrong``                 wrong shape or type
``cameras_wrong``               declared, stored and expected cameras differ
``too_short``                   fewer than two ticks
``not_finite``                  NaN or infinity
``timestamps_not_monotonic``    time does not increase
``action_equals_qpos``          action is the reading
``rate_wrong``                  median interval is not 1/fps
``timestamps_jitter``           interval beyond the limit
``out_of_sync``                 images over 20 ms from joints
``joints_wrong``                wrong joint count
``outside_joint_limits``        wrong order, units or limits
``images_black``                black frame
``images_constant``             frame of one colour
``images_frozen``               constant during motion
``cameras_identical``           two cameras are equal
``cameras_swapped``             another camera's view
==============================  ==================================================================
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from minidual.demos import checks, schema
from minidual.demos.checks import Problem
from minidual.demos.schema import EpisodeMeta
from minidual.errors import DataError
from minidual.robot.pair import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Episode:
    """One episode; see `minidual.demos.schema`."""

    meta: EpisodeMeta
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

    @property
    def duration_s(self) -> float:
        """First to last tick [s]."""
        return float(self.timestamps[-1] - self.timestamps[0])

    @property
    def sync_error_max_s(self) -> float:
        """Largest time between joints and images; NaN without image times."""
        if self.image_timestamps is None:
            return float("nan")
        return float(np.max(np.abs(self.image_timestamps - self.timestamps)))


def episode_paths(folder: Path | str) -> list[Path]:
    """Return a folder's finished episodes."""
    return sorted(Path(folder).glob("episode_[0-9]*.hdf5"))


def read_meta(path: Path | str) -> EpisodeMeta:
    """Return the metadata; raises as `read_episode`."""
    episode, problems = _load(Path(path), (), fields=())
    return _sound(path, episode, problems).meta


def read_episode(path: Path | str, *, cameras: Sequence[str] | None = None) -> Episode:
    """Read one episode; `cameras` None loads all images.

    Raises:
        DataError: Missing, corrupt, or of another schema.
    """
    return _sound(path, *_load(Path(path), cameras))


def validate_episode(path: Path | str, **options: Any) -> list[Problem]:
    """Return every fault; options as `inspect_episode`."""
    return inspect_episode(path, **options)[1]


def inspect_episode(
    path: Path | str,
    *,
    cameras: Sequence[str] | None = None,
    robot: Robot | None = None,
    references: checks.Thumbnails | None = None,
    max_jitter_s: float | None = None,
) -> tuple[Episode | None, list[Problem]]:
    """Return an episode (None if unreadable) and every fault; reads all arrays to verify checksums.

    `cameras`, `robot` and `references` (from `checks.camera_references`) are checked unless None.
    """
    episode, problems = _load(Path(path), None)
    if episode is not None and cameras is not None and tuple(cameras) != episode.meta.cameras:
        detail = f"cameras are {_list(episode.meta.cameras)}; expected {_list(cameras)}"
        problems.append(Problem("cameras_wrong", detail, _CAMERAS))
    if episode is not None and len(episode) < 2:
        problems.append(Problem("too_short", f"{len(episode)} ticks; an episode has at least 2"))
    if episode is None or problems:
        return episode, problems
    e = episode
    problems += checks.check_finite({f.key: v for f in schema.FIELDS if (v := getattr(e, f.name)) is not None})
    problems += checks.check_monotonic(e.timestamps)
    if e.image_timestamps is not None:
        problems += checks.check_monotonic(e.image_timestamps, "image_timestamps")
    problems += checks.check_action_is_command(e.qpos, e.action)
    if problems:
        return episode, problems
    problems += checks.check_rate(e.timestamps, e.meta.fps, max_jitter_s)
    if e.image_timestamps is not None:
        problems += checks.check_sync(e.timestamps, e.image_timestamps)
    if robot is not None:
        problems += checks.check_limits(e.qpos, robot)
    problems += checks.check_images(e.images, e.qpos)
    if references is not None:
        problems += checks.check_swapped(checks.thumbnails(e.images), references)
    return episode, problems


_CAMERAS = "record with the cameras of the configuration, in its order"


def _sound(path: Path | str, episode: Episode | None, problems: list[Problem]) -> Episode:
    if episode is None or problems:
        raise DataError(f"{path}: {problems[0].detail}", remedy=problems[0].remedy)
    return episode


def _load(
    path: Path, cameras: Sequence[str] | None, fields: Sequence[schema.Field] = schema.FIELDS
) -> tuple[Episode | None, list[Problem]]:
    if not path.is_file():
        remedy = "check the folder, or record: minidual teleop-record"
        return None, [Problem("file_missing", f"no episode file {path}", remedy)]
    arrays: dict[str, Array] = dict.fromkeys((f.name for f in schema.FIELDS if f.required), np.empty(0))
    images: dict[str, NDArray[np.uint8]] = {}
    problems: list[Problem] = []
    try:
        with h5py.File(path, "r") as file:
            try:
                meta, ticks = EpisodeMeta.from_attrs(file.attrs)
            except DataError as error:
                return None, [Problem("attributes_wrong", f"{path.name}: {error.message}")]
            joints_n = _joints_n(file)
            for field in fields:
                if field.key in file:
                    expected = (ticks, *field.row_shape(joints_n))
                    found = file[field.key]
                    if not isinstance(found, h5py.Dataset) or found.shape != expected or found.dtype.kind not in "fiu":
                        problems.append(_wrong(field.key, found, f"float64 {expected}"))
                    else:
                        arrays[field.name] = np.asarray(found[()], dtype=np.float64)
                elif field.required:
                    problems.append(Problem("field_missing", f"{field.key} is missing"))
            problems += _load_images(file, meta, ticks, cameras, images)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError) as error:
        return None, [Problem("file_corrupt", f"{path.name} is truncated or corrupt: {error}")]
    return (None if problems else Episode(meta, images, path=path, **arrays)), problems


def _joints_n(file: h5py.File) -> int:
    """Return the width of qpos, or else of action."""
    widths = [
        f.shape[1]
        for f in map(file.get, ("observations/qpos", "action"))
        if isinstance(f, h5py.Dataset) and f.ndim == 2
    ]
    return widths[0] if widths else 0


def _load_images(
    file: h5py.File, meta: EpisodeMeta, ticks: int, cameras: Sequence[str] | None, images: dict[str, NDArray[np.uint8]]
) -> list[Problem]:
    problems: list[Problem] = []
    stored = list(file["observations/images"]) if "observations/images" in file else []
    wanted = stored if cameras is None else cameras
    if cameras is None and sorted(stored) != sorted(meta.cameras):
        detail = f"the file declares cameras {_list(meta.cameras)} and stores {_list(stored)}"
        problems.append(Problem("cameras_wrong", detail, _CAMERAS))
    if absent := [camera for camera in wanted if camera not in stored]:
        problems.append(
            Problem("cameras_wrong", f"no camera {_list(absent)}; there are {_list(meta.cameras)}", _CAMERAS)
        )
        return problems
    for camera in sorted(wanted, key=lambda c: meta.cameras.index(c) if c in meta.cameras else -1):
        key = schema.image_key(camera)
        found = file[key]
        if (
            not isinstance(found, h5py.Dataset)
            or found.dtype != np.uint8
            or found.ndim != 4
            or found.shape[::3] != (ticks, 3)
        ):
            problems.append(_wrong(key, found, f"uint8 ({ticks}, H, W, 3)"))
        else:
            images[camera] = np.asarray(found[()], dtype=np.uint8)
    return problems


def _wrong(key: str, found: Any, expected: str) -> Problem:
    is_array = isinstance(found, h5py.Dataset)
    return Problem(
        "field_wrong", f"{key} is {f'{found.dtype} {found.shape}' if is_array else 'a group'}; it must be {expected}"
    )


def _list(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"
