"""Goals of every kind, and the schema of goal files (docs/planning-scenes.md).

poses:
  left: {position_m: [0.5, 0.25, 0.3], rpy_rad: [3.1416, 0, 0]}
linear: true
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from minidual.collision.scene_file import Finite3, PlaceFields
from minidual.config.base import StrictModel
from minidual.config.document import read_document
from minidual.config.validation import validate_document
from minidual.durable import kind_of, read_json
from minidual.errors import ConfigError, DataError, UsageError, unknown_name

_KINDS = ("state", "joints_rad", "joints_by_name_rad", "poses", "move")
_SUFFIXES = (".yaml", ".yml", ".json")
_BYTES_MAX = 2**26  # a minute of motion


class TipPose(PlaceFields):
    """Tcp pose; a missing orientation is that of the start."""

    frame: str = "world"
    """"world", a link (where it is at the start), an obstacle or a held object."""


class TipOffset(StrictModel):
    """Shift, and rotation vector about the tcp's origin."""

    offset_m: Finite3 = (0.0, 0.0, 0.0)
    rotation_rad: Finite3 = (0.0, 0.0, 0.0)


class _Hands[T](StrictModel):
    left: T | None = None
    right: T | None = None

    def named(self) -> dict[str, T]:
        """Return {arm: entry} of the hands that have one."""
        entries = {"left": self.left, "right": self.right}
        return {side: entry for side, entry in entries.items() if entry is not None}


class Poses(_Hands[TipPose]):
    """Tcp poses; with both_arms a missing hand keeps its pose."""


class Move(_Hands[TipOffset]):
    """Tcp offsets, in the axes of the world or of each tcp."""

    frame: Literal["world", "tcp"] = "world"


class Goal(StrictModel):
    """A goal of planning: exactly one of the first five fields."""

    state: str | None = None
    joints_rad: tuple[float, ...] | None = None
    """Joints of the group or of the robot."""
    joints_by_name_rad: dict[str, float] | None = None
    """Unnamed joints stay."""
    poses: Poses | None = None
    move: Move | None = None
    linear: bool = False
    """Straight lines; only with poses or move."""
    fraction_min: float = Field(default=1.0, gt=0.0, le=1.0)
    """Part of the lines that suffices."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        kinds = [kind for kind in _KINDS if getattr(self, kind) is not None]
        if len(kinds) != 1:
            present = " and ".join(kinds) or "no goal"
            raise ValueError(f"it holds {present}; give one of {', '.join(_KINDS)}")
        hands = self.poses or self.move
        if hands is not None and not hands.named():
            raise ValueError(f"{kinds[0]} names neither left nor right")
        if self.linear and hands is None:
            raise ValueError(f"linear goes with poses or move, not with {kinds[0]}")
        if self.fraction_min < 1.0 and not self.linear:
            raise ValueError("fraction_min goes with linear: true")
        return self


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
        raise ConfigError(
            f"{path.name}: the goal file is empty",
            remedy=f"give one of {', '.join(_KINDS)}",
        )
    return validate_document(document, Goal)


def _end_of_trajectory(path: Path) -> Goal:
    try:
        content = read_json(path, _BYTES_MAX)
        last = content["q_rad"][-1]
        return Goal(joints_by_name_rad=dict(zip(content["joint_names"], last, strict=True)))
    except (ValueError, TypeError, KeyError, IndexError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise DataError(f"{path} is no trajectory of `minidual plan --out`: {reason}") from error


def goal_of(word: str, state_names: Iterable[str]) -> Goal:
    """Return the goal named by a state or file.

    Raises:
        UsageError: Neither exists.
    """
    names = tuple(state_names)
    if word in names:
        return Goal(state=word)
    path = Path(word)
    if path.suffix.lower() in _SUFFIXES:
        if not kind_of(path):
            raise UsageError(f"there is no file {path}")
        return load_goal(path)
    error = unknown_name("named state", word, names)
    raise UsageError(f"{error.message}; a file ends in .yaml or .json", remedy=error.remedy)
