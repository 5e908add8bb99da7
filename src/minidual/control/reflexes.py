"""The supervisor's reflexes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from minidual.errors import MinidualError
from minidual.robot.pair import Array


@dataclass(frozen=True)
class ReflexKind:
    """A row of REFLEXES.

    Attributes:
        remedy: What to check.
    """

    cause: str
    remedy: str
    unit: str


REFLEXES: dict[str, ReflexKind] = {
    "joint_position": ReflexKind(
        "a joint is beyond its position limit, or too fast to stop before it",
        "keep targets inside the limits and slow down towards them; minidual.robot.arms has the limits",
        "rad",
    ),
    "joint_velocity": ReflexKind(
        "a joint is faster than its limit",
        "lower the velocity scale of the plan, or filter the targets (control/reference.py)",
        "rad/s",
    ),
    "torque_range": ReflexKind(
        "a controller asked for more torque than the motor has",
        "clip the controller's output and find out why it needs so much: gains, payload, a jump of the target",
        "Nm",
    ),
    "torque_rate": ReflexKind(
        "a controller kept asking for faster changes of torque than the motors follow",
        "look for an oscillation or chatter: lower gains, filter velocities, smooth the reference",
        "Nm/s",
    ),
    "torque_saturation": ReflexKind(
        "a motor stood at its torque limit",
        "slow the motion down, lighten the load, or free the arm if it pushes against something",
        "Nm",
    ),
    "reference_acceleration": ReflexKind(
        "the commanded reference accelerates more than the joint may",
        "time the trajectory within the limits (plan.planner.acceleration_scale), or send targets through the filter",
        "rad/s^2",
    ),
    "reference_jerk": ReflexKind(
        "the acceleration of the commanded reference jumps",
        "use a profile with bounded jerk (quintic, ruckig), or send targets through a filter",
        "rad/s^3",
    ),
    "tcp_speed": ReflexKind(
        "a hand is faster than its limit", "slow the motion down, or plan with a limit on the speed of the hand", "m/s"
    ),
    "joint_contact": ReflexKind(
        "an arm touches something", "free the arm by hand; see what it met, and what it holds", "Nm"
    ),
    "joint_stuck": ReflexKind(
        "a joint stands still under a torque that should move it",
        "see what blocks it: its brake, its gear, an obstacle",
        "Nm",
    ),
    "cartesian_contact": ReflexKind(
        "a hand presses on something", "free the arm by hand; see what it met, and what it holds", "N"
    ),
    "tracking_error": ReflexKind(
        "a joint does not follow its reference",
        "see what holds it: an obstacle, a load, a stuck or weak joint, an encoder that is off",
        "rad",
    ),
    "gripper_opened": ReflexKind(
        "a hand has lost its grip though it is told to hold", "look at the hand's drive and supply, then open it", ""
    ),
    "workspace": ReflexKind(
        "a hand is leaving the workspace",
        "check the target; widen supervisor.workspace_m if the place is truly free",
        "m",
    ),
    "self_collision": ReflexKind(
        "two parts of the arms come too close",
        "plan around it (minidual plan checks collisions), or part the arms by hand before the reset",
        "m",
    ),
    "stopping_distance": ReflexKind(
        "a stop would end in a collision",
        "slow down near the table, the other arm and what is held, or plan around them (minidual plan)",
        "m",
    ),
    "emergency_stop": ReflexKind(
        "the emergency stop was pressed", "make the scene safe, then reset the supervisor", ""
    ),
    "not_finite": ReflexKind(
        "a measurement or a torque is not a finite number",
        "look at the sensors and at the controller's inputs: the first that is not finite is the cause",
        "",
    ),
    "implausible_measurement": ReflexKind(
        "position and velocity of a joint contradict one another, or do not answer its torque",
        "look at the encoders of the named joint; supervisor.position_mismatch_rad and frozen_s are the bounds",
        "",
    ),
    "stale_measurement": ReflexKind(
        "nothing new is measured",
        "see that the plant delivers its state; supervisor.measurement_age_max_s is how old it may be",
        "s",
    ),
    "clock": ReflexKind(
        "the control time does not grow",
        "see to the plant's clock; call reset() of the supervisor whenever the world is reset",
        "",
    ),
    "controller_failed": ReflexKind(
        "a controller, a source, a sensor or a monitor has failed",
        "remove what it names, or recover with controllers that need less, such as both_arms",
        "",
    ),
    "stale_command": ReflexKind(
        "nobody has given a command for too long",
        "see that the source runs and keeps its rate; supervisor.stale_s is how long it may be silent",
        "s",
    ),
}


@dataclass(frozen=True)
class Reflex:
    """A triggered reflex.

    Attributes:
        name: Key of REFLEXES.
        where: Joint, hand, pair of parts, or reason.
        value: NaN possible for `not_finite`.
        details: Measurements and requested torque of that tick (JSON types).
    """

    name: str
    time_s: float
    where: str
    value: float
    bound: float | None
    details: Mapping[str, Any] = field(default_factory=dict, compare=False)

    @property
    def kind(self) -> ReflexKind:
        """Its table row."""
        return REFLEXES[self.name]

    @property
    def text(self) -> str:
        """One line with value and bound."""
        unit = f" {self.kind.unit}" if self.kind.unit else ""
        numbers = "" if self.bound is None else f" ({self.value:.6g}{unit}, bound {self.bound:.6g}{unit})"
        return f"reflex {self.name} at {self.time_s:.3f} s: {self.kind.cause}: {self.where}{numbers}"


class ReflexError(MinidualError):
    """The supervisor stops the arms; raised once per reflex.

    Attributes:
        tau: (n,) [Nm] to apply in this tick; finite, within limits.
        dump: File for `minidual replay`, if written.
        no_dump: Why writing failed.
    """

    def __init__(self, reflex: Reflex, tau: Array, dump: Path | None = None, no_dump: str = "") -> None:
        look = f"; minidual replay {dump} shows the last second" if dump is not None else ""
        look += f"; the last second was not written: {no_dump}" if no_dump else ""
        super().__init__(reflex.text, remedy=reflex.kind.remedy + look)
        self.reflex = reflex
        self.tau = tau
        self.dump = dump
        self.no_dump = no_dump

    def __reduce__(self) -> tuple[object, ...]:
        return (type(self), (self.reflex, self.tau, self.dump, self.no_dump))
