"""The supervisor's reflexes: families of causes, each with a remedy."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from minidual.errors import MinidualError
from minidual.robot.pair import Array


@dataclass(frozen=True)
class Cause:
    """What has happened, and the unit of the value that shows it."""

    text: str
    unit: str = ""


@dataclass(frozen=True)
class ReflexKind:
    """A family of reflexes.

    Attributes:
        remedy: What to check.
        causes: By detail; the detail is empty in families of one.
    """

    remedy: str
    causes: Mapping[str, Cause]


REFLEXES: dict[str, ReflexKind] = {
    "joint_position": ReflexKind(
        "keep targets inside the limits and slow down towards them; minidual.robot.pair has the limits",
        {"": Cause("a joint is beyond its position limit, or too fast to stop before it", "rad")},
    ),
    "speed": ReflexKind(
        "slow the motion down: lower the velocity scale of the plan, or send targets through the filter",
        {
            "joint": Cause("a joint is faster than its limit", "rad/s"),
            "hand": Cause("a hand is faster than its limit", "m/s"),
        },
    ),
    "torque": ReflexKind(
        "look for an oscillation, a jump of the target, a load that is too heavy, or gains that are too high",
        {
            "range": Cause("a controller asked for more torque than the motor has", "Nm"),
            "rate": Cause(
                "a controller asks for faster changes of torque than the motors follow", "Nm/s"
            ),
            "saturation": Cause("a motor stood at its torque limit", "Nm"),
        },
    ),
    "reference": ReflexKind(
        "time the trajectory within the limits (plan.planner.acceleration_scale), or send targets "
        "through the filter",
        {
            "acceleration": Cause(
                "the commanded reference accelerates more than the joint may", "rad/s^2"
            ),
            "jerk": Cause("the acceleration of the commanded reference jumps", "rad/s^3"),
        },
    ),
    "contact": ReflexKind(
        "free the arm by hand; see what it met, what blocks it, and what it holds",
        {
            "joint": Cause("an arm touches something", "Nm"),
            "stuck": Cause("a joint stands still under a torque that should move it", "Nm"),
            "hand": Cause("a hand presses on something", "N"),
        },
    ),
    "tracking_error": ReflexKind(
        "see what holds the joint: an obstacle, a load, a weak motor, an encoder that is off",
        {"": Cause("a joint does not follow its reference", "rad")},
    ),
    "gripper_opened": ReflexKind(
        "look at the hand's drive and supply, then open it",
        {"": Cause("a hand has lost its grip although it is told to hold")},
    ),
    "clearance": ReflexKind(
        "plan around what is in the way (minidual plan checks collisions), or slow down near it",
        {
            "workspace": Cause("a hand is leaving the workspace (supervisor.workspace_m)", "m"),
            "arms": Cause("two parts of the arms come too close", "m"),
            "stop": Cause("a stop would end in a collision", "m"),
        },
    ),
    "emergency_stop": ReflexKind(
        "make the scene safe, then reset the supervisor",
        {"": Cause("the emergency stop was pressed")},
    ),
    "measurement": ReflexKind(
        "look at the named sensor; supervisor.position_mismatch_rad, frozen_s and "
        "measurement_age_max_s are the bounds",
        {
            "not_finite": Cause("a measurement is not a finite number"),
            "implausible": Cause("readings of a joint contradict one another, or stand still"),
            "stale": Cause("nothing new is measured", "s"),
            "clock": Cause("the control time does not grow"),
        },
    ),
    "plant_failed": ReflexKind(
        "mend what the plant names; recover() is refused until it reports no fault",
        {"": Cause("the plant reports a fault")},
    ),
    "controller_failed": ReflexKind(
        "remove what it names, or recover with controllers that need less, such as both_arms",
        {"": Cause("a controller, a source, a sensor or a monitor has failed")},
    ),
    "stale_command": ReflexKind(
        "see that the source runs and keeps its rate; supervisor.stale_s is how long it may be silent",
        {"": Cause("no command has come for too long", "s")},
    ),
    "passivity": ReflexKind(
        "leave teleop.link.passive on; see the energies of the link in attempts/*-link.csv",
        {"": Cause("the link between leader and arms makes energy", "J")},
    ),
}


@dataclass(frozen=True)
class Reflex:
    """A triggered reflex.

    Attributes:
        name: Key of REFLEXES.
        detail: Key of its causes.
        where: Joint, hand, pair of parts, or reason.
        value: NaN possible for what is not finite.
        details: Measurements and requested torque of that tick (JSON types).
    """

    name: str
    detail: str
    time_s: float
    where: str
    value: float = 1.0
    bound: float | None = None
    details: Mapping[str, Any] = field(default_factory=dict, compare=False)

    @property
    def label(self) -> str:
        """Name and detail."""
        return f"{self.name}.{self.detail}" if self.detail else self.name

    @property
    def remedy(self) -> str:
        """What to check."""
        return REFLEXES[self.name].remedy

    @property
    def text(self) -> str:
        """One line with value and bound."""
        cause = REFLEXES[self.name].causes[self.detail]
        line = f"reflex {self.label} at {self.time_s:.3f} s: {cause.text}: {self.where}"
        if self.bound is None:
            return line
        unit = f" {cause.unit}" if cause.unit else ""
        return f"{line} ({self.value:.6g}{unit}, bound {self.bound:.6g}{unit})"


class ReflexError(MinidualError):
    """The supervisor stops the arms; raised once per reflex.

    Attributes:
        tau: (n,) [Nm] to apply in this tick; finite, within limits.
        dump: File for `minidual replay`, if written.
    """

    remedy: str

    def __init__(self, reflex: Reflex, tau: Array) -> None:
        super().__init__(reflex.text, remedy=reflex.remedy)
        self.reflex = reflex
        self.tau = tau
        self.dump: Path | None = None
