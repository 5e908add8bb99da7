"""Sources of demonstrated joint angles."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Self

from minidual.config.learning import TeleopConfig
from minidual.motion.api import Planner
from minidual.registry import Registry
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot
from minidual.skills.demonstrated_plan import demonstrate_plan
from minidual.skills.operator import Demonstration, ScriptedOperator
from minidual.tasks.task import Task, Trial


@dataclass(frozen=True)
class LeaderSetup:
    """Inputs of a leader, fixed during a recording."""

    robot: Robot
    task: Task
    config: TeleopConfig
    seed: int

    @cached_property
    def planner(self) -> Planner:
        """Of tasks whose plan is demonstrated."""
        return Planner(config=self.task.config.plan.planner, robot=self.robot)


class Leader(ABC):
    """Leads one trial.

    Attributes:
        realtime: A person or device leads: wall-clock speed, one process, not repeatable.
        usage: Instructions, printed before the recording.
    """

    realtime: ClassVar[bool] = False
    usage: ClassVar[str] = ""

    @classmethod
    @abstractmethod
    def for_trial(cls, setup: LeaderSetup, trial: Trial) -> Self:
        """Return a trial's leader; EnvironmentMissingError without its device."""

    @abstractmethod
    def read(self, now_s: float) -> tuple[Array, Array] | None:
        """Return joints (n,) [rad] and openings (2,) at a time since the start.

        None without a reading.
        """

    @abstractmethod
    def finished(self, now_s: float) -> bool:
        """Return whether the episode has ended."""

    def close(self) -> None:  # noqa: B027 (most leaders hold nothing)
        """Release resources."""


class ScriptedLeader(Leader):
    """Plays the scripted operator's plan."""

    def __init__(self, demonstration: Demonstration) -> None:
        self.demonstration = demonstration

    @classmethod
    def for_trial(cls, setup: LeaderSetup, trial: Trial) -> Self:
        """Plan a trial.

        By phases where both hands hold one object all the way, else as the task is planned.
        """
        rate_hz = setup.config.rate_hz
        if setup.task.together:
            operator = ScriptedOperator(
                setup.task.scene,
                setup.config.operator,
                kinematics=Kinematics(setup.robot),
            )
            return cls(operator.plan(trial, seed=setup.seed, rate_hz=rate_hz))
        return cls(
            demonstrate_plan(setup.task, trial, setup.planner, seed=setup.seed, rate_hz=rate_hz),
        )

    def read(self, now_s: float) -> tuple[Array, Array] | None:
        """Return the plan at `now_s`."""
        return self.demonstration.at(now_s)

    def finished(self, now_s: float) -> bool:
        """Return whether the plan has ended."""
        half_tick_s = 0.5 / self.demonstration.rate_hz
        return now_s >= self.demonstration.duration_s - half_tick_s


LEADERS: Registry[type[Leader]] = Registry("leader", group="minidual.leaders")
"""Leaders by `teleop.leader`; those of other distributions are entry points of the group."""
LEADERS.add("scripted", ScriptedLeader)
LEADERS.add("keyboard", "minidual.demos.keyboard:KeyboardLeader")
