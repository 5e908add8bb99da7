"""The one place that names what an episode file holds: HDF5 keys, shapes, dtypes and attributes.

One file is one episode, in the layout ALOHA uses. With T ticks and the arms in the order left, right:

====================================  ==============  =========  ==========================================
key                                   shape           dtype      meaning
====================================  ==============  =========  ==========================================
``observations/qpos``                 (T, 14)         float64    measured joint positions, rad
``observations/qvel`` (optional)      (T, 14)         float64    measured joint velocities, rad/s
``observations/gripper``              (T, 2)          float64    measured opening of left, right gripper
``observations/images/<camera>``      (T, H, W, 3)    uint8      RGB image
``action``                            (T, 14)         float64    joint targets commanded at t, rad
``action_gripper``                    (T, 2)          float64    gripper targets commanded at t
``timestamps``                        (T,)            float64    time of the joint reading, monotonic, s
``image_timestamps`` (optional)       (T,)            float64    time of the images, where it differs, s
====================================  ==============  =========  ==========================================

``action[t]`` is the command that leads to the state at t + 1. It is never the reading at t: a recording
whose action equals its qpos teaches a policy to stand still.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from minidual.errors import DataError

SCHEMA_VERSION = 1

JOINTS_N = 14
GRIPPERS_N = 2

QPOS = "observations/qpos"
QVEL = "observations/qvel"
GRIPPER = "observations/gripper"
IMAGES = "observations/images"
ACTION = "action"
ACTION_GRIPPER = "action_gripper"
TIMESTAMPS = "timestamps"
IMAGE_TIMESTAMPS = "image_timestamps"

ATTR_NUM_TIMESTEPS = "num_timesteps"
ATTR_SUCCESS = "success"
ATTR_SIM = "sim"
ATTR_FPS = "fps"
ATTR_TASK = "task"
ATTR_SEED = "seed"
ATTR_CAMERAS = "cameras"
ATTR_SCHEMA_VERSION = "schema_version"
ATTR_EXTRA = "extra"

REQUIRED_ATTRS = (
    ATTR_NUM_TIMESTEPS,
    ATTR_SUCCESS,
    ATTR_SIM,
    ATTR_FPS,
    ATTR_TASK,
    ATTR_SEED,
    ATTR_CAMERAS,
    ATTR_SCHEMA_VERSION,
)

#: Joints, images and action of one tick may lie this far apart at most.
MAX_SYNC_S = 0.020


@dataclass(frozen=True)
class Field:
    """One numeric dataset of the file: its key, the shape of one row, and whether a file must have it."""

    key: str
    row_shape: tuple[int, ...]
    required: bool = True

    @property
    def dtype(self) -> str:
        """The stored type; every numeric field is float64, images alone are uint8."""
        return "float64"


#: Every numeric dataset, in file order. Images are listed by camera in ``EpisodeMeta.cameras``.
FIELDS: tuple[Field, ...] = (
    Field(QPOS, (JOINTS_N,)),
    Field(QVEL, (JOINTS_N,), required=False),
    Field(GRIPPER, (GRIPPERS_N,)),
    Field(ACTION, (JOINTS_N,)),
    Field(ACTION_GRIPPER, (GRIPPERS_N,)),
    Field(TIMESTAMPS, ()),
    Field(IMAGE_TIMESTAMPS, (), required=False),
)


def image_key(camera: str) -> str:
    """Return the HDF5 key of a camera's images, e.g. ``observations/images/high``."""
    return f"{IMAGES}/{camera}"


@dataclass(frozen=True)
class EpisodeMeta:
    """What an episode is, beside its arrays.

    Attributes:
        fps: Recording rate, 1/s.
        task: The task in words, as a policy conditioned on language would read it.
        seed: Seed of the episode's randomisation.
        cameras: Camera names in their fixed order, e.g. ``("high", "left", "right")``.
        sim: True for simulation, False for hardware.
        success: Whether the episode achieved the task.
        extra: Further facts (failure reason, start pose, operator); anything JSON can hold.
    """

    fps: float
    task: str
    seed: int
    cameras: tuple[str, ...]
    sim: bool = True
    success: bool = False
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse a rate, camera name or duplicate that could not be written or read back."""
        if not (0.0 < self.fps < 1e5):
            raise DataError(f"fps is {self.fps}; it must be a finite rate above 0")
        if len(set(self.cameras)) != len(self.cameras):
            raise DataError(f"camera names repeat: {', '.join(self.cameras)}")
        for camera in self.cameras:
            if not camera or "/" in camera or "." in camera:
                raise DataError(f"camera name '{camera}' is empty or holds '/' or '.'")
        try:
            json.dumps(dict(self.extra), allow_nan=False)
        except (TypeError, ValueError) as error:
            raise DataError(f"extra facts of an episode must be plain JSON without NaN: {error}") from error

    @property
    def trial(self) -> int:
        """Number of the trial that the episode shows (`extra["trial"]`); DataError if it was not recorded."""
        number = self.extra.get("trial")
        if not isinstance(number, int):
            raise DataError(f"the episode names no trial (extra facts: {', '.join(self.extra) or 'none'})")
        return number

    def to_attrs(self, num_timesteps: int) -> dict[str, Any]:
        """Return the file attributes for an episode of `num_timesteps` ticks."""
        return {
            ATTR_NUM_TIMESTEPS: int(num_timesteps),
            ATTR_SUCCESS: bool(self.success),
            ATTR_SIM: bool(self.sim),
            ATTR_FPS: float(self.fps),
            ATTR_TASK: self.task,
            ATTR_SEED: int(self.seed),
            ATTR_CAMERAS: json.dumps(list(self.cameras)),
            ATTR_SCHEMA_VERSION: SCHEMA_VERSION,
            ATTR_EXTRA: json.dumps(dict(self.extra), sort_keys=True, allow_nan=False),
        }

    @staticmethod
    def from_attrs(attrs: Mapping[str, Any]) -> EpisodeMeta:
        """Read the attributes back; raise DataError for one that is missing, broken or of another version."""
        missing = [name for name in REQUIRED_ATTRS if name not in attrs]
        if missing:
            raise DataError(f"missing attributes: {', '.join(missing)}")
        version = int(attrs[ATTR_SCHEMA_VERSION])
        if version != SCHEMA_VERSION:
            raise DataError(f"schema version {version}; this program reads version {SCHEMA_VERSION}")
        try:
            return EpisodeMeta(
                fps=float(attrs[ATTR_FPS]),
                task=str(attrs[ATTR_TASK]),
                seed=int(attrs[ATTR_SEED]),
                cameras=tuple(str(name) for name in json.loads(attrs[ATTR_CAMERAS])),
                sim=bool(attrs[ATTR_SIM]),
                success=bool(attrs[ATTR_SUCCESS]),
                extra=json.loads(attrs.get(ATTR_EXTRA, "{}")),
            )
        except (ValueError, TypeError) as error:
            raise DataError(f"unreadable attributes: {error}") from error
