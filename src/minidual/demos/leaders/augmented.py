"""Recorded demonstrations lead at other starts and goals."""

from collections.abc import Mapping
from typing import ClassVar, Self

from minidual.collision.errors import PlanningError
from minidual.config.seeds import stream
from minidual.demos.augment.moving import distance, moved
from minidual.demos.augment.segments import read_sources
from minidual.demos.leader import Features, LeaderSetup
from minidual.demos.leaders.playing import PlayingLeader
from minidual.errors import UsageError
from minidual.motion.ik import PoseUnreachableError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.tasks.task import Trial, placement


class AugmentedLeader(PlayingLeader):
    """Plays one of the nearest recorded demonstrations, moved to the trial's start and goal.

    Attributes:
        refused: Why demonstrations at `teleop.augment.path` are not used.
    """

    features: ClassVar[Features] = Features()

    def __init__(self, setup: LeaderSetup) -> None:
        task = setup.task
        if not task.together:
            raise UsageError(
                f"demonstrations are moved where both hands hold one object all the way; "
                f"in the task '{task.name}' they do not",
                remedy="--task rod_carry or --task pot_lift",
            )
        config = setup.config.augment
        self._setup = setup
        self._kinematics = Kinematics(setup.robot)
        self._sources, self.refused = read_sources(
            config.path,
            self._kinematics,
            config.near_m,
            config.demonstrations_n,
        )
        joints_n = self._sources[0].q.shape[1]
        if joints_n != setup.robot.dof:
            raise UsageError(
                f"the episodes have {joints_n} joints, the arms have {setup.robot.dof}",
                remedy="--set robot.arm=NAME of the arms that recorded them",
            )
        self._source_name = ""

    @property
    def sources_n(self) -> int:
        """Demonstrations that are moved."""
        return len(self._sources)

    @property
    def facts(self) -> Mapping[str, object]:
        """See `Leader.facts`."""
        return {"source": self._source_name}

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        """Read the demonstrations.

        Raises:
            UsageError: There are none, or the task is no carry.
        """
        return cls(setup)

    def align(self, trial: Trial, q_follower: Array) -> None:
        """Choose a demonstration and move it.

        Raises:
            PlanningError: A hand cannot reach a moved pose.
        """
        name = self._setup.task.carried
        symmetry = self._setup.task.objects[name].symmetry
        start = placement(trial.start[name])
        goal = placement(trial.goal[name])
        nearest = sorted(self._sources, key=lambda each: distance(each, start, goal, symmetry))
        rng = stream(self._setup.seed, "augment.source", trial.index)
        among = min(self._setup.config.augment.nearest_n, len(nearest))
        source = nearest[int(rng.integers(among))]
        self._source_name = source.name
        try:
            self.demonstration = moved(source, start, goal, self._kinematics, symmetry)
        except PoseUnreachableError as error:
            raise PlanningError(f"moved, {error.message}") from error
