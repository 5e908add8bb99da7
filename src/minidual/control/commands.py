"""Data passing through the arbiter."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar, Protocol

from minidual.control.impedance import ObjectState
from minidual.robot.pair import Array, arms_of
from minidual.robot.trajectory import Trajectory

SOURCES: tuple[str, ...] = ("moveit", "teleop", "policy")
"""Command sources, each also a mode."""

HOLD = "hold"
"""Mode without a driving source."""


class _OfGroup:
    group: str

    @property
    def arms(self) -> tuple[int, ...]:
        """Indices of the driven arms."""
        return arms_of(self.group)


@dataclass(frozen=True)
class JointCommand(_OfGroup):
    """A joint target, streamed at 50 to 100 Hz.

    Attributes:
        q: [rad], (n,) left then right, or one arm's.
        gripper: Openings (2,), 0 closed to 1 open; one arm's command moves its hand only.
        stamp_s: Creation time on the arbiter's clock.
        sequence: Increases with each command of the source.
        group: `both_arms`, `left_arm` or `right_arm`.
    """

    q: Array
    gripper: Array
    stamp_s: float
    sequence: int
    group: str = "both_arms"


@dataclass(frozen=True)
class TrajectoryCommand(_OfGroup):
    """A timed joint trajectory.

    Attributes:
        motion: Of both arms or one, at rest at both ends; must start at the arms' posture.
        stamp_s: Creation time; it must be taken within `stale_s`.
    """

    motion: Trajectory
    gripper: Array
    stamp_s: float
    sequence: int
    group: str = "both_arms"


class ObjectMotion(Protocol):
    """Timed object path, at rest at both ends (such as `ObjectPath`)."""

    @property
    def duration_s(self) -> float:
        """Duration [s]."""
        ...

    def at(self, t_s: float) -> ObjectState:
        """Return the state at a path time."""
        ...


@dataclass(frozen=True)
class ObjectCommand:
    """Timed path of the object in both hands, with its squeeze.

    Attributes:
        motion: Must start at the object's pose.
        squeeze_n: Internal force by path time, 0 to 80.
    """

    motion: ObjectMotion
    squeeze_n: Callable[[float], float]
    gripper: Array
    stamp_s: float
    sequence: int
    arms: ClassVar[tuple[int, ...]] = (0, 1)


TimedCommand = TrajectoryCommand | ObjectCommand
Command = JointCommand | TimedCommand
Reason = tuple[str, str]
"""Why something is refused: stable name (docs/refusals.md), and detail with value and bound."""


@dataclass(frozen=True)
class Refusal:
    """A refused command or request; `name` and `detail` as in Reason."""

    source: str
    name: str
    detail: str


class RefusalLog:
    """Refusals since they were taken last."""

    def __init__(self) -> None:
        self._refusals: list[Refusal] = []

    def note(self, source: str, name: str, detail: str) -> Refusal:
        """Add a refusal and return it."""
        refusal = Refusal(source, name, detail)
        self._refusals.append(refusal)
        return refusal

    def supersede(self, mode: str | None, detail: str) -> None:
        """Add that a requested mode, if any, was overridden by a later request or a halt."""
        if mode is not None:
            self.note(mode, "superseded", detail)

    def take(self) -> tuple[Refusal, ...]:
        """Return the refusals and forget them."""
        refusals = tuple(self._refusals)
        self._refusals = []
        return refusals


class ArbiterState(StrEnum):
    """What the arbiter does.

    settling: waits for still arms. waiting: a source may drive, nothing runs. aligning: the target approaches the
    source's at a bounded rate. stale: the source is silent. stopped: halted, silent too long or not still in time.
    """

    HOLDING = "holding"
    SETTLING = "settling"
    WAITING = "waiting"
    ALIGNING = "aligning"
    ACTIVE = "active"
    STALE = "stale"
    STOPPED = "stopped"
