"""The scripted operator leads."""

from typing import Self

from minidual.demos.leader import LeaderSetup
from minidual.demos.leaders.playing import PlayingLeader
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.demonstrated_plan import demonstrate_plan
from minidual.skills.operator import Demonstration, ScriptedOperator
from minidual.tasks.task import Trial


class ScriptedLeader(PlayingLeader):
    """Plays the scripted operator's plan of each trial.

    Args:
        demonstration: Played for every trial; None: planned for each.
    """

    def __init__(self, demonstration: Demonstration | None = None) -> None:
        self._setup: LeaderSetup | None = None
        if demonstration is not None:
            self.demonstration = demonstration

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        """Return an operator that plans when a trial begins."""
        leader = cls()
        leader._setup = setup
        return leader

    def align(self, trial: Trial, q_follower: Array) -> None:
        """Plan the trial."""
        if self._setup is not None:
            self.demonstration = plan_demonstration(self._setup, trial)


def plan_demonstration(setup: LeaderSetup, trial: Trial) -> Demonstration:
    """Return the plan of a trial.

    By phases where both hands hold one object all the way, else as the task is planned.
    """
    rate_hz = setup.config.rate_hz
    if setup.task.together:
        operator = ScriptedOperator(
            setup.task.scene,
            setup.config.operator,
            kinematics=Kinematics(setup.robot),
        )
        return operator.plan(trial, seed=setup.seed, rate_hz=rate_hz)
    return demonstrate_plan(setup.task, trial, setup.planner, seed=setup.seed, rate_hz=rate_hz)
