"""Goals as data classes and YAML; see docs/planning-scenes.md.

poses:
  left: {position_m: [0.5, 0.25, 0.3], rpy_rad: [3.1416, 0, 0]}
linear: true
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from minidual.collision.places import Finite3, PlaceFields
from minidual.collision.shapes import Quat, Vec3
from minidual.config.base import StrictModel
from minidual.config.document import read_document
from minidual.config.loader import validate_document
from minidual.errors import ConfigError, DataError, UsageError, unknown_name

OffsetFrame = Literal["world", "tcp"]
_KINDS = ("state", "joints_rad", "joints_by_name_rad", "poses", "move")


@dataclass(frozen=True)
class StateGoal:
    """A named state, for example "home"."""

    name: str


@dataclass(frozen=True)
class JointGoal:
    """Joints [rad] of the group or robot, or {joint name: value}; unnamed joints stay."""

    values: tuple[float, ...] | Mapping[str, float]


@dataclass(frozen=True)
class TipPose:
    """Tcp pose in `frame`: "world", a link (at the start), an obstacle or a held object.

    Without `quat_wxyz` the start orientation is kept.
    """

    position_m: Vec3
    quat_wxyz: Quat | None = None
    frame: str = "world"


@dataclass(frozen=True)
class PoseGoal:
    """Tcp poses by arm; with both_arms a missing arm keeps its pose.

    `linear` asks for straight lines; `fraction_min` is the smallest acceptable part of them.
    """

    poses: Mapping[str, TipPose]
    linear: bool = False
    fraction_min: float = 1.0


@dataclass(frozen=True)
class TipOffset:
    """Shift [m] and rotation vector [rad] about the tcp's origin."""

    offset_m: Vec3 = (0.0, 0.0, 0.0)
    rotation_rad: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RelativeGoal:
    """Tcp offsets by arm, in world or own axes; otherwise like `PoseGoal`."""

    offsets: Mapping[str, TipOffset] = field(default_factory=dict)
    frame: OffsetFrame = "world"
    linear: bool = False
    fraction_min: float = 1.0


Goal = StateGoal | JointGoal | PoseGoal | RelativeGoal


class _Hands[T](StrictModel):
    left: T | None = None
    right: T | None = None

    def named(self) -> dict[str, T]:
        return {side: entry for side in ("left", "right") if (entry := getattr(self, side)) is not None}


class PoseEntry(PlaceFields):
    """See `TipPose`."""

    frame: str = "world"


class OffsetEntry(StrictModel):
    """See `TipOffset`."""

    offset_m: Finite3 = (0.0, 0.0, 0.0)
    rotation_rad: Finite3 = (0.0, 0.0, 0.0)
    """Rotation vector."""


class MoveEntry(_Hands[OffsetEntry]):
    """Tcp offsets."""

    frame: OffsetFrame = "world"


class GoalFile(StrictModel):
    """Exactly one kind of goal."""

    state: str | None = None
    joints_rad: tuple[float, ...] | None = None
    joints_by_name_rad: dict[str, float] | None = None
    poses: _Hands[PoseEntry] | None = None
    move: MoveEntry | None = None
    linear: bool = False
    """Only with poses or move."""
    fraction_min: float = Field(default=1.0, gt=0.0, le=1.0)
    """See `PoseGoal`."""

    @model_validator(mode="after")
    def _one_kind(self) -> GoalFile:
        kinds = [kind for kind in _KINDS if getattr(self, kind) is not None]
        if len(kinds) != 1:
            raise ValueError(f"it holds {' and '.join(kinds) or 'no goal'}; give one of {', '.join(_KINDS)}")
        hands = getattr(self, kinds[0])
        if isinstance(hands, _Hands):
            if not hands.named():
                raise ValueError(f"{kinds[0]} names neither left nor right")
        elif self.linear:
            raise ValueError(f"linear goes with poses or move, not with {kinds[0]}")
        if self.fraction_min < 1.0 and not self.linear:
            raise ValueError("fraction_min goes with linear: true")
        return self

    def goal(self) -> Goal:
        """Return the goal as a data class."""
        if self.poses is not None:
            tips = {arm: TipPose(e.position_m, e.quaternion(), e.frame) for arm, e in self.poses.named().items()}
            return PoseGoal(tips, self.linear, self.fraction_min)
        if self.move is not None:
            offsets = {arm: TipOffset(e.offset_m, e.rotation_rad) for arm, e in self.move.named().items()}
            return RelativeGoal(offsets, self.move.frame, self.linear, self.fraction_min)
        if self.state is not None:
            return StateGoal(self.state)
        values = self.joints_by_name_rad if self.joints_rad is None else self.joints_rad
        assert values is not None
        return JointGoal(values)


def load_goal(path: Path) -> Goal:
    """Return the goal in a YAML file, or the last sample of a JSON trajectory.

    Raises:
        ConfigError: Invalid YAML.
        DataError: Not a trajectory.
    """
    if path.suffix.lower() == ".json":
        return _end_of_trajectory(path)
    document = read_document(path)
    if not document.tree:
        raise ConfigError(f"{path.name}: the goal file is empty", remedy=f"give one of {', '.join(_KINDS)}")
    return validate_document(document, GoalFile).goal()


def goal_of(word: str, state_names: Iterable[str]) -> Goal:
    """Return the goal named by a state or file.

    Raises:
        UsageError: Neither exists.
    """
    names = tuple(state_names)
    if word in names:
        return StateGoal(word)
    path = Path(word)
    if path.suffix.lower() in (".yaml", ".yml", ".json"):
        if not path.is_file():
            raise UsageError(f"there is no file {path}")
        return load_goal(path)
    error = unknown_name("named state", word, names)
    raise UsageError(f"{error.message}; a file ends in .yaml or .json", remedy=error.remedy)


def _end_of_trajectory(path: Path) -> JointGoal:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return JointGoal({str(n): float(v) for n, v in zip(content["joint_names"], content["q_rad"][-1], strict=True)})
    except (OSError, ValueError, TypeError, KeyError, IndexError) as error:
        raise DataError(f"{path} is no trajectory of `minidual plan --out`: {type(error).__name__}: {error}") from error
