"""Schema of an episode: one HDF5 file in ALOHA's layout.

T ticks, n joints, left arm first:

key                                   shape         meaning
``observations/qpos``                 (T, n)        positions [rad]
``observations/qvel`` (optional)      (T, n)        velocities [rad/s]
``observations/gripper``              (T, 2)        openings
``observations/images/<camera>``      (T, H, W, 3)  RGB uint8; other arrays: float64
``action``                            (T, n)        joint targets [rad]
``action_gripper``                    (T, 2)        opening targets
``timestamps``                        (T,)          joint time, increasing [s]
``image_timestamps`` (optional)       (T,)          image time [s]

``action[t]`` leads to the state at t + 1.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from minidual.errors import DataError
from minidual.registry import rows_beside
from minidual.robot.pair import GRIPPERS_N

SCHEMA_VERSION = 1
TICKS = "num_timesteps"
"""Attribute: number of ticks."""
MAX_SYNC_S = 0.020
"""Largest time between joints and images."""
_PLAIN = {
    "success": bool,
    "sim": bool,
    "fps": float,
    "task": str,
    "seed": int,
}  # attributes that are not JSON


class Field(NamedTuple):
    """One float64 array; `axes` are those of a row."""

    name: str
    key: str
    axes: Sequence[str]
    required: bool = True

    def row_shape(self, joints_n: int) -> tuple[int, ...]:
        """Return the row shape."""
        return tuple(joints_n if axis == "joints" else GRIPPERS_N for axis in self.axes)


FIELDS = tuple(Field(name, **row) for name, row in rows_beside(__file__).items())
"""Every numeric array."""


def image_key(camera: str) -> str:
    """Return the HDF5 key of a camera's images."""
    return f"observations/images/{camera}"


@dataclass(frozen=True)
class EpisodeMeta:
    """File attributes.

    Attributes:
        task: Instruction text.
        cameras: In fixed order.
        sim: False for hardware.
        extra: JSON facts (trial, reason, start).
    """

    fps: float
    task: str
    seed: int
    cameras: tuple[str, ...]
    sim: bool = True
    success: bool = False
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise DataError for values that cannot be stored."""
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
            raise DataError(
                f"extra facts of an episode must be plain JSON without NaN: {error}",
            ) from error

    @property
    def trial(self) -> int:
        """Trial number; DataError if not recorded."""
        number = self.extra.get("trial")
        if not isinstance(number, int):
            raise DataError(
                f"the episode names no trial (extra facts: {', '.join(self.extra) or 'none'})",
            )
        return number

    def to_attrs(self, ticks: int) -> dict[str, Any]:
        """Return the attributes of a file."""
        plain = {name: kind(getattr(self, name)) for name, kind in _PLAIN.items()}
        cameras = json.dumps(list(self.cameras))
        extra = json.dumps(dict(self.extra), sort_keys=True, allow_nan=False)
        return {
            TICKS: int(ticks),
            **plain,
            "cameras": cameras,
            "schema_version": SCHEMA_VERSION,
            "extra": extra,
        }

    @staticmethod
    def from_attrs(attrs: Mapping[str, Any]) -> tuple[EpisodeMeta, int]:
        """Return (meta, ticks); DataError if missing, invalid or of another version."""
        required = EpisodeMeta(1.0, "", 0, ()).to_attrs(0).keys() - {"extra"}
        if missing := sorted(required - attrs.keys()):
            raise DataError(f"missing attributes: {', '.join(missing)}")
        try:
            if (version := int(attrs["schema_version"])) != SCHEMA_VERSION:
                raise DataError(
                    f"schema version {version}; this program reads version {SCHEMA_VERSION}",
                )
            plain: dict[str, Any] = {name: kind(attrs[name]) for name, kind in _PLAIN.items()}
            cameras = tuple(map(str, json.loads(attrs["cameras"])))
            meta = EpisodeMeta(cameras=cameras, extra=json.loads(attrs.get("extra", "{}")), **plain)
            if (ticks := int(attrs[TICKS])) < 0:
                raise DataError(f"{TICKS} is {ticks}")
            return meta, ticks
        except (ValueError, TypeError, OverflowError, RecursionError) as error:
            raise DataError(f"unreadable attributes: {error}") from error
