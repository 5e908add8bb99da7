"""Life cycle, health and kinds of command of a plant, beside the members that the control loop uses.

The control loop needs `plant.protocol.Plant` only. A plant that is reached through a network has
more to say; a `Connection` asks it, and answers in its place where it is silent.
"""

from collections.abc import Sequence
from enum import StrEnum
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self

import numpy as np

from minidual.errors import UsageError
from minidual.plant.protocol import Plant
from minidual.robot.pair import SIDES, Array, Robot, slower_robot

if TYPE_CHECKING:  # a plant on a network needs no simulator
    from minidual.plant.twin import Twin


class CommandKind(StrEnum):
    """Kinds of command that a plant takes in a control step.

    torque: motor torques, at 1 kHz. position: joint targets with their velocities, at 50 to 1000
    Hz; the plant interpolates and controls its motors.
    """

    TORQUE = "torque"
    POSITION = "position"


RATES_HZ: dict[CommandKind, tuple[float, float]] = {
    CommandKind.TORQUE: (1000.0, 1000.0),
    CommandKind.POSITION: (50.0, 1000.0),
}
"""Least and largest control rate of each kind."""
_PLANNED_ACCELERATION_SHARE = 0.5


class PositionPlant(Plant, Protocol):
    """A plant that takes joint targets; `command` is not called."""

    kind: CommandKind

    def follow(self, q: Array, v: Array, openings: Array) -> None:
        """Set joint targets (n,) [rad], their velocities (n,) [rad/s], and hand openings (2,).

        An opening of 0 closes a hand until its fingers press, 1 opens it; NaN leaves it as it is.
        """
        ...


class ArmHealth(NamedTuple):
    """Health of one arm.

    Attributes:
        arm: `left` or `right`.
        faults: Why it cannot be driven, by name; empty if it can.
    """

    arm: str
    faults: tuple[str, ...] = ()

    @property
    def well(self) -> bool:
        """Whether it can be driven."""
        return not self.faults


class Sent(NamedTuple):
    """The last command as it was sent to the arms; `None` arrays where the kind has none.

    Attributes:
        kind: Kind of command.
        stamp_s: When, on the plant's clock.
        tau: Torques (n,) [Nm].
        q: Joint targets (n,) [rad].
        v: Their velocities (n,) [rad/s].
    """

    kind: CommandKind
    stamp_s: float
    tau: Array | None = None
    q: Array | None = None
    v: Array | None = None


def kind_of(plant: object) -> CommandKind:
    """Return the kind of command that a plant takes; torques if it does not say."""
    return CommandKind(getattr(plant, "kind", CommandKind.TORQUE))


def runs_on(plant: object) -> bool:
    """Return whether a plant's time runs on between steps; it then has `catch_up()`."""
    return hasattr(plant, "catch_up")


def braking_share(plant: object) -> float:
    """Return at which share of the arms' acceleration a plant brakes; it takes longer to rest."""
    return float(getattr(plant, "braking_share", 1.0))


def planned_robot(plant: Any) -> Robot:
    """Return the arms of a plant with the limits that plans keep to.

    A stop begins up to two control periods late. Where a plant brakes slowly, plans take half of its
    acceleration, so that a stop on the way ends before the end of the plan.
    """
    robot: Robot = plant.robot
    if braking_share(plant) == 1.0:
        return robot
    return slower_robot(robot, 1.0, _PLANNED_ACCELERATION_SHARE)


def catch_up(plant: Any) -> None:
    """Let a plant whose time runs on read its newest measurements."""
    if runs_on(plant):
        plant.catch_up()


class Connection:
    """Life cycle of one plant: connect, activate, ask, recover, close.

    A plant may have `connect()`, `activate(kind)`, `stamps_s`, `healths`, `sent`, `recover()`,
    `close()`, `kinds`, `place`, `braking_share`, `catch_up()` and `twin()`. What it lacks has a
    default.

    Attributes:
        address: As typed, for messages and reports.
        plant: What the control stack drives.
    """

    def __init__(self, address: str, plant: Any) -> None:
        self.address = address
        self.plant = plant

    @property
    def place(self) -> str:
        """Kind of what is driven, such as `simulator`, `emulator` or `hardware`."""
        return str(getattr(self.plant, "place", "external plant"))

    @property
    def kinds(self) -> tuple[CommandKind, ...]:
        """Kinds of command that the plant can be activated for."""
        return tuple(getattr(self.plant, "kinds", (kind_of(self.plant),)))

    def open(self, kind: CommandKind | None = None) -> Self:
        """Connect, and activate for a kind of command; by default the plant's first.

        Raises:
            UsageError: The plant does not take that kind, or not at its rate.
        """
        kind = self.kinds[0] if kind is None else kind
        if kind not in self.kinds:
            taken = " and ".join(self.kinds)
            raise UsageError(
                f"plant '{self.address}' takes no {kind} commands; it takes {taken}",
                remedy=getattr(self.plant, "why_not", {}).get(kind),
            )
        self._call("connect")
        self._call("activate", kind)
        least_hz, most_hz = RATES_HZ[kind]
        rate_hz = 1.0 / self.plant.dt
        if not least_hz - 1e-6 <= rate_hz <= most_hz + 1e-6:
            self.close()
            raise UsageError(
                f"plant '{self.address}' takes {kind} commands at {rate_hz:g} Hz; "
                f"{kind} commands come at {least_hz:g} to {most_hz:g} Hz",
                remedy="set its dt",
            )
        return self

    @property
    def stamps_s(self) -> Array:
        """Times (2,) [s] of the arms' measurements, on the plant's clock."""
        stamps = getattr(self.plant, "stamps_s", None)
        return np.full(len(SIDES), self.plant.stamp_s) if stamps is None else np.array(stamps)

    @property
    def healths(self) -> Sequence[ArmHealth]:
        """Health of each arm."""
        healths = getattr(self.plant, "healths", None)
        if healths is not None:
            return healths
        faults = (self.plant.health,) if self.plant.health else ()
        return [ArmHealth(side, faults) for side in SIDES]

    @property
    def sent(self) -> Sent | None:
        """The last command as it was sent; None if the plant does not report it."""
        return getattr(self.plant, "sent", None)

    def twin(self) -> "Twin | None":
        """Return the simulated world behind the plant; None on hardware.

        Raises:
            UsageError: It is another scene than the configured one.
        """
        make = getattr(self.plant, "twin", None)
        return None if make is None else make()

    def recover(self) -> None:
        """Clear the faults that can be cleared; `healths` has the rest."""
        self._call("recover")

    def close(self) -> None:
        """Release the plant; the arms stay under their own control."""
        self._call("close")

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _call(self, name: str, *arguments: object) -> None:
        method = getattr(self.plant, name, None)
        if method is not None:
            method(*arguments)
