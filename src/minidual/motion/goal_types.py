"""What can be asked for: one small family of goals, each plain data. `minidual.motion.goal_plan` resolves them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from minidual.collision.shapes import Quat, Vec3

OffsetFrame = Literal["world", "tcp"]


@dataclass(frozen=True)
class StateGoal:
    """A named state of the semantics, for example "home"."""

    name: str


@dataclass(frozen=True)
class JointGoal:
    """Joint values [rad].

    values: All of the group's joints (or all 14), or {joint name: value} for some; the others stay.
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
        linear: Whether each tcp goes there on a straight line.
        fraction_min: For a straight line, the least part of it that is worth having.
    """

    offsets: Mapping[str, TipOffset] = field(default_factory=dict)
    frame: OffsetFrame = "world"
    linear: bool = False
    fraction_min: float = 1.0


Goal = StateGoal | JointGoal | PoseGoal | RelativeGoal
