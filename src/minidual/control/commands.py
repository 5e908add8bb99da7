"""What travels through the arbiter: proposed commands, refusals, and what goes on to the controllers.

* `JointCommand`       a joint target, streamed at 50 to 100 Hz (leader, policy)
* `TrajectoryCommand`  a timed joint trajectory, taken once and run at 1 kHz (planner)
* `ObjectCommand`      a timed path of a held object with its squeeze, run at 1 kHz (object impedance)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from minidual.control.object_impedance import ObjectState
from minidual.robot.pair import SIDES, Array

SOURCES: tuple[str, ...] = ("moveit", "teleop", "policy")
"""Who may propose commands; each is a mode, and at most one drives at a time."""

HOLD = "hold"
"""The mode in which nobody drives."""


def arms_of(group: str) -> tuple[int, ...]:
    """Return the indices of the arms of a group (`both_arms`, `left_arm`, `right_arm`)."""
    return (0, 1) if group == "both_arms" else (SIDES.index(group.removesuffix("_arm")),)


@dataclass(frozen=True)
class JointCommand:
    """A joint target that a source proposes.

    Attributes:
        q: Joint targets [rad]: (n,) left then right, or one arm's.
        gripper: Opening of the left and the right hand (2,), 0 closed to 1 open. A single arm's command
            moves its own hand only.
        stamp_s: When the source made it [s], on the arbiter's clock.
        sequence: Counts up with every command of the source.
        group: `both_arms`, `left_arm` or `right_arm`.
    """

    q: Array
    gripper: Array
    stamp_s: float
    sequence: int
    group: str = "both_arms"

    @property
    def arms(self) -> tuple[int, ...]:
        """Indices of the arms that this command drives."""
        return arms_of(self.group)

    def target_of(self, arm: int) -> Array:
        """Return the joint targets [rad] of one of its arms."""
        if self.group != "both_arms":
            return self.q
        half = len(self.q) // 2
        return self.q[arm * half : (arm + 1) * half]


class TimedMotion(Protocol):
    """A joint trajectory on a regular time grid, at rest at both ends (`planning.Trajectory` is one).

    q, v, a: (samples, joints of both arms or of one). Of both arms' columns a single arm's command uses its own.
    """

    @property
    def q(self) -> Array:
        """Positions [rad]."""
        ...

    @property
    def v(self) -> Array:
        """Velocities [rad/s]."""
        ...

    @property
    def a(self) -> Array:
        """Accelerations [rad/s^2]."""
        ...

    @property
    def dt_s(self) -> float:
        """Step between samples [s]."""
        ...

    @property
    def duration_s(self) -> float:
        """Time of the last sample [s]."""
        ...

    def sample_many(self, times: Array) -> tuple[Array, Array, Array]:
        """Return (q, v, a) at times (m,) [s], each (m, joints)."""
        ...


@dataclass(frozen=True)
class TrajectoryCommand:
    """A timed joint trajectory that a source proposes once; it starts when the arbiter takes it and ends at rest.

    Attributes:
        motion: The trajectory; it must start where the arms are.
        gripper: Openings (2,) from its start on.
        stamp_s: When the source made it [s]. One not taken within `stale_s` is refused.
        sequence: Counts up with every command of the source.
        group: `both_arms`, `left_arm` or `right_arm`.
    """

    motion: TimedMotion
    gripper: Array
    stamp_s: float
    sequence: int
    group: str = "both_arms"

    @property
    def arms(self) -> tuple[int, ...]:
        """Indices of the arms that this command drives."""
        return arms_of(self.group)


class ObjectMotion(Protocol):
    """A path of a held object in time, at rest at both ends (`control.ObjectPath` is one)."""

    @property
    def duration_s(self) -> float:
        """When it ends [s]."""
        ...

    def at(self, t_s: float) -> ObjectState:
        """Return pose, twist and acceleration of the object at a time [s]."""
        ...


@dataclass(frozen=True)
class ObjectCommand:
    """A path of the object in both hands, and how hard they press it together.

    Attributes:
        motion: The path; it must start where the object is.
        squeeze_n: Internal force [N] at a time [s] of the path, 0 to 80.
        gripper: Openings (2,) from its start on.
        stamp_s: When the source made it [s]. One not taken within `stale_s` is refused.
        sequence: Counts up with every command of the source.
    """

    motion: ObjectMotion
    squeeze_n: Callable[[float], float]
    gripper: Array
    stamp_s: float
    sequence: int

    @property
    def arms(self) -> tuple[int, ...]:
        """Both: an internal force takes two hands."""
        return (0, 1)


TimedCommand = TrajectoryCommand | ObjectCommand
Command = JointCommand | TimedCommand


@dataclass(frozen=True)
class Refusal:
    """A command or request that was not let through, and why.

    Attributes:
        source: Who proposed it.
        name: Stable name; docs/control.md lists them all.
        detail: The value and the bound.
    """

    source: str
    name: str
    detail: str


class ArbiterState(StrEnum):
    """What the arbiter does with the arms.

    holding: nobody drives. settling: a switch waits for the arms to be still. waiting: the source may drive and has
    nothing under way. aligning: the target moves at a bounded rate towards the source's. active: the source's commands go
    through. stale: the source is silent; its last target is held. stopped: it stayed silent, or the arms did not come to
    rest; only a new request leads on.
    """

    HOLDING = "holding"
    SETTLING = "settling"
    WAITING = "waiting"
    ALIGNING = "aligning"
    ACTIVE = "active"
    STALE = "stale"
    STOPPED = "stopped"
