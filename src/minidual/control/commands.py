"""What travels through the arbiter: a proposed command, a refusal, and what goes on to the controllers."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from minidual.robot.constants import ARMS, DOF_PER_ARM, GROUPS, JOINT_NAMES, Q_LOWER, Q_UPPER, Array

SOURCES: tuple[str, ...] = ("moveit", "teleop", "policy")
"""Who may propose commands; each is a mode of the system, and one at most drives at a time."""

HOLD = "hold"
"""The mode in which nobody drives."""

_LIMIT_TOLERANCE_RAD = 1e-6
_ZERO_RAD = 1e-12


@dataclass(frozen=True)
class JointCommand:
    """A joint target that a source proposes.

    Attributes:
        q: Joint targets [rad]: (14,) left then right, or (7,) for a single arm.
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
        return (0, 1) if self.group == "both_arms" else (ARMS.index(self.group.removesuffix("_arm")),)

    def target_of(self, arm: int) -> Array:
        """Return the seven joint targets [rad] of one of its arms."""
        start = arm * DOF_PER_ARM if self.group == "both_arms" else 0
        return self.q[start : start + DOF_PER_ARM]


@dataclass(frozen=True)
class Refusal:
    """A command or request that was not let through, and why.

    Attributes:
        source: Who proposed it.
        name: Stable name: `unknown_group`, `wrong_shape`, `not_finite`, `all_zero`, `out_of_limits`,
            `gripper_out_of_range`, `out_of_order`, `before_switch`, `from_future`, `superseded`, `not_still`.
        detail: The value and the bound.
    """

    source: str
    name: str
    detail: str


class ArbiterState(StrEnum):
    """What the arbiter does with the arms.

    holding: nobody drives; the posture is held. settling: a switch waits for the arms to be still.
    waiting: the new source may drive, and has not spoken yet. aligning: the target moves at a bounded rate
    from the present posture to what the source asks for. active: the source's commands go through. stale: the
    source fell silent; its last target is held. stopped: it stayed silent, or the arms would not come to rest;
    only a new request goes on from here.
    """

    HOLDING = "holding"
    SETTLING = "settling"
    WAITING = "waiting"
    ALIGNING = "aligning"
    ACTIVE = "active"
    STALE = "stale"
    STOPPED = "stopped"


@dataclass(frozen=True)
class ArbiterOutput:
    """What reaches the controllers at one tick; the only thing that does.

    Attributes:
        q_target: (14,) [rad], always finite and inside the limits.
        gripper: (2,), 0 closed to 1 open.
        state: What the arbiter does.
        active_source: Whose command went through in this tick, or None while a posture is held.
        held_arms: Arms that no fresh command drives in this tick.
        switched_to: The mode whose request was confirmed in this tick, or None.
        refusals: Everything refused since the last tick.
    """

    q_target: Array
    gripper: Array
    state: ArbiterState
    active_source: str | None
    held_arms: tuple[str, ...]
    switched_to: str | None
    refusals: tuple[Refusal, ...]


def find_fault(command: JointCommand) -> tuple[str, str] | None:
    """Return (name, detail) of what is wrong with a command by itself, or None."""
    if command.group not in GROUPS:
        return "unknown_group", f"no group '{command.group}'; there are {', '.join(sorted(GROUPS))}"
    joints = GROUPS[command.group]
    names = JOINT_NAMES[joints]
    if np.shape(command.q) != (len(names),) or np.shape(command.gripper) != (2,):
        given = f"q {np.shape(command.q)} and gripper {np.shape(command.gripper)}"
        return "wrong_shape", f"{given}; group {command.group} needs ({len(names)},) and (2,)"
    finite = np.isfinite(command.q)
    if not finite.all():
        index = int(np.argmin(finite))
        return "not_finite", f"{names[index]} = {command.q[index]}"
    if not (np.isfinite(command.gripper).all() and np.isfinite(command.stamp_s)):
        return "not_finite", f"gripper {command.gripper}, stamp {command.stamp_s}"
    if np.abs(command.q).max() < _ZERO_RAD:
        return "all_zero", "every joint at 0.0 rad: a source that has not been given its values, or lost them"
    lower, upper = Q_LOWER[joints] - _LIMIT_TOLERANCE_RAD, Q_UPPER[joints] + _LIMIT_TOLERANCE_RAD
    outside = (command.q < lower) | (command.q > upper)
    if outside.any():
        index = int(np.argmax(outside))
        return (
            "out_of_limits",
            f"{names[index]} = {command.q[index]:.4f} rad; {Q_LOWER[joints][index]:.4f} to {Q_UPPER[joints][index]:.4f}",
        )
    if command.gripper.min() < 0.0 or command.gripper.max() > 1.0:
        return "gripper_out_of_range", f"gripper {command.gripper}; 0 (closed) to 1 (open)"
    return None
