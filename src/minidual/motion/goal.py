"""What can be asked for, as plain data and as YAML. `minidual.motion.goal_plan` resolves it.

    poses:
      left: {position_m: [0.5, 0.25, 0.3], rpy_rad: [3.1416, 0, 0]}
    linear: true

A word may stand for a file: the name of a state. A trajectory that `minidual plan --out` wrote (.json) stands for its
last sample. See docs/planning-scenes.md.
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
    """Joint values [rad].

    values: All of the group's joints (or of both arms), or {joint name: value} for some; the others stay.
    """

    values: tuple[float, ...] | Mapping[str, float]


@dataclass(frozen=True)
class TipPose:
    """Where one tcp shall be.

    Attributes:
        position_m: In `frame`.
        quat_wxyz: In `frame`; None keeps the orientation that the tcp has at the start.
        frame: "world", a link (where it is at the start), an obstacle or a held object of the scene.
    """

    position_m: Vec3
    quat_wxyz: Quat | None = None
    frame: str = "world"


@dataclass(frozen=True)
class PoseGoal:
    """Poses of one or both tcps.

    Attributes:
        poses: {"left": ..., "right": ...}; with both_arms an arm that is left out keeps its tcp where it is.
        linear: Whether each tcp goes there on a straight line.
        fraction_min: For a straight line, the least part of it that is worth having.
    """

    poses: Mapping[str, TipPose]
    linear: bool = False
    fraction_min: float = 1.0


@dataclass(frozen=True)
class TipOffset:
    """How far one tcp shall move: a shift [m] and a turn (rotation vector [rad]) about its own origin."""

    offset_m: Vec3 = (0.0, 0.0, 0.0)
    rotation_rad: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RelativeGoal:
    """Offsets from where the tcps are at the start.

    Attributes:
        offsets: {"left": ..., "right": ...}; with both_arms an arm that is left out keeps its tcp where it is.
        frame: Axes in which shift and turn are given: those of the world, or each tcp's own.
        linear, fraction_min: As for `PoseGoal`.
    """

    offsets: Mapping[str, TipOffset] = field(default_factory=dict)
    frame: OffsetFrame = "world"
    linear: bool = False
    fraction_min: float = 1.0


Goal = StateGoal | JointGoal | PoseGoal | RelativeGoal


class _Hands[T](StrictModel):
    left: T | None = None
    right: T | None = None

    def named(self) -> dict[str, T]:
        """Return what is said of each hand."""
        return {side: entry for side in ("left", "right") if (entry := getattr(self, side)) is not None}


class PoseEntry(PlaceFields):
    """Where one tcp shall be; without an orientation it keeps the one that it has."""

    frame: str = "world"


class OffsetEntry(StrictModel):
    """How far one tcp shall move."""

    offset_m: Finite3 = (0.0, 0.0, 0.0)
    rotation_rad: Finite3 = (0.0, 0.0, 0.0)
    """Rotation vector about the tcp's own origin."""


class MoveEntry(_Hands[OffsetEntry]):
    """Offsets of one or both tcps."""

    frame: OffsetFrame = "world"


class GoalFile(StrictModel):
    """Everything that a goal file may hold: exactly one kind of goal."""

    state: str | None = None
    joints_rad: tuple[float, ...] | None = None
    joints_by_name_rad: dict[str, float] | None = None
    poses: _Hands[PoseEntry] | None = None
    move: MoveEntry | None = None
    linear: bool = False
    """Move each tcp on a straight line; goes with poses and move."""
    fraction_min: float = Field(default=1.0, gt=0.0, le=1.0)
    """The least part of a straight line that is worth having."""

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
        """Return the goal as plain data."""
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
    """Return the goal of a YAML file, or the last sample of a trajectory in JSON.

    Raises:
        ConfigError: It is empty or does not hold; with file, line and dotted path.
        DataError: The JSON is no trajectory.
    """
    if path.suffix.lower() == ".json":
        return _end_of_trajectory(path)
    document = read_document(path)
    if not document.tree:
        raise ConfigError(f"{path.name}: the goal file is empty", remedy=f"give one of {', '.join(_KINDS)}")
    return validate_document(document, GoalFile).goal()


def goal_of(word: str, state_names: Iterable[str]) -> Goal:
    """Return the goal that a word on the command line stands for: a state's name, or a file.

    Raises:
        UsageError: Neither; with the states that exist.
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
