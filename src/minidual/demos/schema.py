"""Schema of an episode: one HDF5 file in ALOHA's layout.

T ticks, n joints, left arm first:

key                                   shape         meaning
``observations/qpos``                 (T, n)        positions [rad]
``observations/qvel`` (optional)      (T, n)        velocities [rad/s]
``observations/effort`` (optional)    (T, n)        motor torques [Nm]
``observations/gripper``              (T, 2)        openings
``observations/images/<camera>``      (T, H, W, 3)  RGB uint8; other arrays: float64
``action``                            (T, n)        joint targets [rad]
``action_gripper``                    (T, 2)        opening targets
``timestamps``                        (T,)          joint time, increasing [s]
``image_timestamps`` (optional)       (T,)          image time [s]

The signals of `teleop.signals` are optional:

``observations/joint_torques``        (T, n)        motor torques [Nm], as ``effort``
``observations/external_torques``     (T, n)        torques that the arms' own motion does not explain [Nm]
``observations/hand_wrench``          (T, 2, 6)     contact on each hand [N, Nm], at the tcp, world axes
``observations/internal_force``       (T,)          hands press on what is between them [N]
``session/arbiter_state``             (T,)          place in `signals.ARBITER_STATES`
``session/reflex``                    (T,)          place in `signals.REFLEX_NAMES`; 0: none
``session/driver``                    (T,)          who drove: 0 leader, 1 policy, 2 correction
``session/late_s``                    (T,)          wall time by which the tick came late [s]
``session/lost_pictures``             (T,)          cameras without a new picture
``signal_timestamps``                 (T,)          time of the signals [s]

``action[t]`` leads to the state at t + 1.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from minidual.errors import DataError
from minidual.robot.pair import GRIPPERS_N

SCHEMA_VERSION = 1
TICKS = "num_timesteps"
"""Attribute: number of ticks."""
REQUIRED_ATTRIBUTES = (
    TICKS,
    "success",
    "sim",
    "fps",
    "task",
    "seed",
    "cameras",
    "schema_version",
)
MAX_SYNC_S = 0.020
"""Largest time between joints and images."""

Axis = Literal["joints", "grippers", "hands", "wrench"]


class Field(NamedTuple):
    """One float64 array of T rows; `axes` are those of a row."""

    name: str
    key: str
    axes: tuple[Axis, ...] = ()
    required: bool = True

    def row_shape(self, joints_n: int) -> tuple[int, ...]:
        """Return the shape of a row for `joints_n` joints."""
        sizes = {"joints": joints_n, "grippers": GRIPPERS_N, "hands": GRIPPERS_N, "wrench": 6}
        return tuple(sizes[axis] for axis in self.axes)


FIELDS = (
    Field("qpos", "observations/qpos", ("joints",)),
    Field("qvel", "observations/qvel", ("joints",), required=False),
    Field("effort", "observations/effort", ("joints",), required=False),
    Field("gripper", "observations/gripper", ("grippers",)),
    Field("action", "action", ("joints",)),
    Field("action_gripper", "action_gripper", ("grippers",)),
    Field("timestamps", "timestamps"),
    Field("image_timestamps", "image_timestamps", required=False),
    Field("joint_torques", "observations/joint_torques", ("joints",), required=False),
    Field("external_torques", "observations/external_torques", ("joints",), required=False),
    Field("hand_wrench", "observations/hand_wrench", ("hands", "wrench"), required=False),
    Field("internal_force", "observations/internal_force", required=False),
    Field("arbiter_state", "session/arbiter_state", required=False),
    Field("reflex", "session/reflex", required=False),
    Field("driver", "session/driver", required=False),
    Field("late_s", "session/late_s", required=False),
    Field("lost_pictures", "session/lost_pictures", required=False),
    Field("signal_timestamps", "signal_timestamps", required=False),
)
"""Every numeric array."""
SIGNALS = (
    "joint_torques",
    "external_torques",
    "hand_wrench",
    "internal_force",
    "arbiter_state",
    "reflex",
    "driver",
    "late_s",
    "lost_pictures",
)
"""Fields that a recording may choose, stamped by `signal_timestamps`."""


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
            names = ", ".join(self.extra) or "none"
            raise DataError(f"the episode names no trial (extra facts: {names})")
        return number

    def to_attrs(self, ticks: int) -> dict[str, Any]:
        """Return the attributes of a file with `ticks` ticks."""
        return {
            TICKS: int(ticks),
            "success": bool(self.success),
            "sim": bool(self.sim),
            "fps": float(self.fps),
            "task": str(self.task),
            "seed": int(self.seed),
            "cameras": json.dumps(list(self.cameras)),
            "schema_version": SCHEMA_VERSION,
            "extra": json.dumps(dict(self.extra), sort_keys=True, allow_nan=False),
        }

    @staticmethod
    def from_attrs(attrs: Mapping[str, Any]) -> tuple[EpisodeMeta, int]:
        """Return (meta, ticks); DataError if missing, invalid or of another version."""
        missing = sorted(set(REQUIRED_ATTRIBUTES) - attrs.keys())
        if missing:
            raise DataError(f"missing attributes: {', '.join(missing)}")
        try:
            return _parsed(attrs)
        except (ValueError, TypeError, OverflowError, RecursionError) as error:
            raise DataError(f"unreadable attributes: {error}") from error


def _parsed(attrs: Mapping[str, Any]) -> tuple[EpisodeMeta, int]:
    version = int(attrs["schema_version"])
    if version != SCHEMA_VERSION:
        raise DataError(f"schema version {version}; this program reads version {SCHEMA_VERSION}")
    meta = EpisodeMeta(
        fps=float(attrs["fps"]),
        task=str(attrs["task"]),
        seed=int(attrs["seed"]),
        cameras=tuple(map(str, json.loads(attrs["cameras"]))),
        sim=bool(attrs["sim"]),
        success=bool(attrs["success"]),
        extra=json.loads(attrs.get("extra", "{}")),
    )
    ticks = int(attrs[TICKS])
    if ticks < 0:
        raise DataError(f"{TICKS} is {ticks}")
    return meta, ticks
