"""Goals and starts in YAML files, and the one word that may stand for a file: the name of a state.

    poses:
      left: {position_m: [0.5, 0.25, 0.3], rpy_rad: [3.1416, 0, 0]}
    linear: true

A trajectory that `minidual plan --out` wrote (.json) may stand for a start: its last sample. See docs/planning-scenes.md.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from minidual.collision.places import Finite3, PlaceFields
from minidual.config.base import StrictModel
from minidual.config.document import read_document
from minidual.config.loader import validate_document
from minidual.errors import ConfigError, DataError, UsageError, unknown_name
from minidual.motion.goal_types import Goal, JointGoal, PoseGoal, RelativeGoal, StateGoal, TipOffset, TipPose
from minidual.robot.constants import JOINT_NAMES

_KINDS = ("state", "joints_rad", "joints_by_name_rad", "poses", "move")


class PoseEntry(PlaceFields):
    """Where one tcp shall be; without an orientation it keeps the one that it has."""

    frame: str = "world"


class OffsetEntry(StrictModel):
    """How far one tcp shall move."""

    offset_m: Finite3 = (0.0, 0.0, 0.0)
    rotation_rad: Finite3 = (0.0, 0.0, 0.0)
    """Rotation vector about the tcp's own origin."""


class PosesEntry(StrictModel):
    """Poses of one or both tcps."""

    left: PoseEntry | None = None
    right: PoseEntry | None = None


class MoveEntry(StrictModel):
    """Offsets of one or both tcps."""

    left: OffsetEntry | None = None
    right: OffsetEntry | None = None
    frame: Literal["world", "tcp"] = "world"


class GoalFile(StrictModel):
    """Everything that a goal file may hold: exactly one kind of goal."""

    state: str | None = None
    joints_rad: tuple[float, ...] | None = None
    joints_by_name_rad: dict[str, float] | None = None
    poses: PosesEntry | None = None
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
        if self.linear and kinds[0] not in ("poses", "move"):
            raise ValueError(f"linear goes with poses or move, not with {kinds[0]}")
        if self.fraction_min < 1.0 and not self.linear:
            raise ValueError("fraction_min goes with linear: true")
        for kind in ("poses", "move"):
            entry = getattr(self, kind)
            if entry is not None and entry.left is None and entry.right is None:
                raise ValueError(f"{kind} names neither left nor right")
        return self

    def goal(self) -> Goal:
        """Return the goal as plain data."""
        if self.state is not None:
            return StateGoal(self.state)
        if self.joints_rad is not None:
            return JointGoal(self.joints_rad)
        if self.joints_by_name_rad is not None:
            return JointGoal(self.joints_by_name_rad)
        if self.poses is not None:
            poses = {
                arm: TipPose(entry.position_m, entry.quaternion(), entry.frame)
                for arm in ("left", "right")
                if (entry := getattr(self.poses, arm)) is not None
            }
            return PoseGoal(poses, self.linear, self.fraction_min)
        assert self.move is not None
        offsets = {
            arm: TipOffset(entry.offset_m, entry.rotation_rad)
            for arm in ("left", "right")
            if (entry := getattr(self.move, arm)) is not None
        }
        return RelativeGoal(offsets, self.move.frame, self.linear, self.fraction_min)


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


def goal_of(word: str, state_names: tuple[str, ...]) -> Goal:
    """Return the goal that a word on the command line stands for: a state's name, or a file.

    Raises:
        UsageError: Neither; with the states that exist.
    """
    if word in state_names:
        return StateGoal(word)
    path = Path(word)
    if path.suffix.lower() in (".yaml", ".yml", ".json"):
        if not path.is_file():
            raise UsageError(f"there is no file {path}")
        return load_goal(path)
    error = unknown_name("named state", word, state_names)
    raise UsageError(f"{error.message}; a file ends in .yaml or .json", remedy=error.remedy)


def _end_of_trajectory(path: Path) -> JointGoal:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        names, last = tuple(content["joint_names"]), tuple(float(v) for v in content["q_rad"][-1])
    except (OSError, ValueError, TypeError, KeyError, IndexError) as error:
        raise DataError(f"{path} is no trajectory of `minidual plan --out`: {type(error).__name__}: {error}") from error
    if names != JOINT_NAMES or len(last) != len(JOINT_NAMES):
        raise DataError(f"{path}: its joints are {', '.join(map(str, names))}; all 14 are needed, left arm first")
    return JointGoal(last)
