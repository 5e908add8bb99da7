"""Leaders: persons, devices and programs that demonstrate, behind one protocol."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, Literal, NamedTuple, Self

import numpy as np

from minidual.config.learning import TeleopConfig
from minidual.control.tick_check import Violation
from minidual.demos.station import NO_STATION, Button, Station
from minidual.motion.api import Planner
from minidual.registry import Registry
from minidual.robot.pair import Array, Robot
from minidual.tasks.task import Task, Trial


@dataclass(frozen=True)
class LeaderSetup:
    """Inputs of a leader, fixed during a recording."""

    robot: Robot
    task: Task
    config: TeleopConfig
    seed: int
    station: Station = field(default=NO_STATION, compare=False)

    @cached_property
    def planner(self) -> Planner:
        """Of tasks whose plan is demonstrated."""
        return Planner(config=self.task.config.plan.planner, robot=self.robot)


@dataclass(frozen=True)
class Features:
    """Abilities of a leader, known before it is connected.

    Attributes:
        targets: Joint angles, or poses of the hands, which inverse kinematics turns into angles.
        grips: Whether hands are open or closed, or anything between; "none": they stay open.
        buttons: That it has; pages and keyboards have others beside it.
        clutch: Whether it can be moved without the arms.
        feedback: Whether it renders what the arms meet.
        realtime: A person or device leads: wall-clock speed, one process, not repeatable.
        picture: It needs the live view, in which a person drags the hands.
        terminal: It reads the keys of the terminal; for others they are buttons.
    """

    targets: Literal["joints", "poses"] = "joints"
    grips: Literal["none", "binary", "continuous"] = "continuous"
    buttons: tuple[Button, ...] = ()
    clutch: bool = False
    feedback: bool = False
    realtime: bool = False
    picture: bool = False
    terminal: bool = False


@dataclass(frozen=True)
class LeaderSample:
    """One reading.

    Attributes:
        openings: Of the left and right hand (2,), 0 closed to 1 open.
        q: Joints (n,) [rad] of a leader that gives joints.
        Ts_world_tcp: Poses (4, 4) of the left and right hand of one that gives poses.
        pressed: Buttons pressed since the last reading.
        clutch: Whether the leader moves without the arms; released, they follow from where they are.
        age_s: Time since the device measured this; None if it does not tell.
    """

    openings: Array
    q: Array | None = None
    Ts_world_tcp: Sequence[Array] | None = None
    pressed: tuple[Button, ...] = ()
    clutch: bool = False
    age_s: float | None = None


class Feedback(NamedTuple):
    """Measurements of the arms in a tick.

    Attributes:
        stamp_s: Time of the measurement.
        q: Joints (n,) [rad].
        openings: Of the hands (2,).
        external_nm: Torques (n,) that nothing but a contact explains.
        met_nm: Torques (n,) that the surroundings put on the arms, steady ones included.
    """

    stamp_s: float
    q: Array
    openings: Array
    external_nm: Array
    met_nm: Array = np.zeros(0)


class Leader(ABC):
    """Leads the trials of a recording, one after the other.

    Attributes:
        features: What it gives.
        usage: Instructions, printed before the recording.
        hint: What a person should see of its state, such as the hand that its keys move.
        violation: What the supervisor is to stop the arms for, or None.
    """

    features: ClassVar[Features] = Features()
    usage: ClassVar[str] = ""
    hint: str = ""
    violation: Violation | None = None

    @classmethod
    @abstractmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        """Return a leader, connected to its device.

        Raises:
            EnvironmentMissingError: The device, or the library that reads it, is missing.
        """

    def align(self, trial: Trial, q_follower: Array) -> None:  # noqa: B027 (many need nothing)
        """Prepare for a trial with the arms at (n,) [rad]; drop the state of the last one."""

    def resume(self, q_follower: Array) -> None:  # noqa: B027 (many need nothing)
        """Lead on from arms that something else has moved to (n,) [rad]; hands may hold something."""

    @abstractmethod
    def read(self, now_s: float) -> LeaderSample | None:
        """Return the newest reading at a time since the start of the trial, without waiting.

        None without one: the arms stop when the last one is too old.
        """

    @property
    def facts(self) -> Mapping[str, object]:
        """Facts of the leader for the episode's file, in JSON types."""
        return {}

    def feedback(self, feedback: Feedback) -> None:  # noqa: B027 (as above)
        """Render the forces on the arms."""

    def close(self) -> None:  # noqa: B027 (as above)
        """Release the device."""


def follows_swiftly(config: TeleopConfig) -> bool:
    """Return whether arms feed the leader's velocity forward (`teleop.following`)."""
    if config.following == "auto":
        return LEADERS[config.leader].features.realtime
    return config.following == "swift"


LEADERS: Registry[type[Leader]] = Registry("leader", group="minidual.leaders")
"""Leaders by `teleop.leader`; those of other distributions are entry points of the group."""
LEADERS.add("scripted", "minidual.demos.leaders.scripted:ScriptedLeader")
LEADERS.add("augmented", "minidual.demos.leaders.augmented:AugmentedLeader")
LEADERS.add("corrector", "minidual.demos.leaders.corrector:ScriptedCorrector")
LEADERS.add("browser", "minidual.demos.leaders.browser:BrowserLeader")
LEADERS.add("gamepad", "minidual.demos.leaders.gamepad:GamepadLeader")
LEADERS.add("gello", "minidual.demos.leaders.gello:GelloLeader")
LEADERS.add("keyboard", "minidual.demos.leaders.keyboard:KeyboardLeader")
LEADERS.add("network", "minidual.demos.leaders.network:NetworkLeader")
LEADERS.add("replay", "minidual.demos.leaders.replay:ReplayLeader")
