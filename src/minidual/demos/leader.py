"""Leaders: who gives the joint angles that the arms follow, and the table of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

from minidual.config.teleop import TeleopConfig
from minidual.registry import Registry
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot
from minidual.skills.operator import Demonstration, ScriptedOperator
from minidual.tasks.task import Task, Trial


@dataclass(frozen=True)
class LeaderSetup:
    """What a leader may be made from; the same for every trial of a recording."""

    robot: Robot
    task: Task
    config: TeleopConfig
    seed: int


class Leader(ABC):
    """Leads one trial.

    Attributes:
        realtime: A person or a device leads: the simulation keeps to the wall clock, one process records, and a trial
            cannot be repeated.
        usage: How to lead, told before the recording.
    """

    realtime: ClassVar[bool] = False
    usage: ClassVar[str] = ""

    @classmethod
    @abstractmethod
    def for_trial(cls, setup: LeaderSetup, trial: Trial) -> Self:
        """Return the leader of a trial; EnvironmentMissingError if a device that it needs is not there."""

    @abstractmethod
    def read(self, now_s: float) -> tuple[Array, Array] | None:
        """Return joints (n,) [rad] and openings (2,) at a time since the start [s]; None where there is no reading."""

    @abstractmethod
    def finished(self, now_s: float) -> bool:
        """Return whether the leader has ended the episode."""

    def close(self) -> None:  # noqa: B027 (most leaders hold nothing)
        """Release what the leader holds."""


class ScriptedLeader(Leader):
    """Plays what the scripted operator planned for the trial."""

    def __init__(self, demonstration: Demonstration) -> None:
        self.demonstration = demonstration

    @classmethod
    def for_trial(cls, setup: LeaderSetup, trial: Trial) -> Self:
        """Plan the trial."""
        operator = ScriptedOperator(setup.task.scene, setup.config.operator, kinematics=Kinematics(setup.robot))
        return cls(operator.plan(trial, seed=setup.seed, rate_hz=setup.config.rate_hz))

    def read(self, now_s: float) -> tuple[Array, Array] | None:
        """Return the planned joints and openings."""
        return self.demonstration.at(now_s)

    def finished(self, now_s: float) -> bool:
        """Return whether the plan has been played to its end."""
        return now_s >= self.demonstration.duration_s - 0.5 / self.demonstration.rate_hz


LEADERS: Registry[type[Leader]] = Registry(
    "leader",
    {"scripted": ScriptedLeader, "keyboard": "minidual.demos.keyboard:KeyboardLeader"},
    group="minidual.leaders",
)
"""Leaders by the name that `teleop.leader` takes."""
