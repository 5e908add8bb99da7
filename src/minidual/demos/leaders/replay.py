"""A recorded episode leads."""

from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from minidual.config.leading import ReplayConfig
from minidual.demos.episode import episode_paths, read_episode
from minidual.demos.leader import Features, LeaderSetup
from minidual.demos.leaders.playing import PlayingLeader
from minidual.demos.lerobot_reader import LeRobotTables, read_dataset
from minidual.errors import UsageError
from minidual.robot.pair import Array, Robot
from minidual.skills.operator import Demonstration
from minidual.tasks.task import Trial


class ReplayLeader(PlayingLeader):
    """Plays the commands of an episode of `teleop.replay.path`, at its own rate."""

    features: ClassVar[Features] = Features()

    def __init__(self, robot: Robot, config: ReplayConfig) -> None:
        self._robot = robot
        self._config = config
        self._path = Path(config.path)
        if not config.path or not self._path.exists():
            raise UsageError(
                f"teleop.replay.path is '{config.path}', where there is nothing",
                remedy="--set teleop.replay.path=runs/NAME/teleop-record/episodes, "
                "one of its files, or a LeRobot dataset",
            )
        self._dataset: LeRobotTables | None = None
        if self._path.is_dir() and not episode_paths(self._path):
            self._dataset = read_dataset(self._path)

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        """Open a recording.

        Raises:
            UsageError: There is nothing.
            DataError: It cannot be read.
        """
        return cls(setup.robot, setup.config.replay)

    def align(self, trial: Trial, q_follower: Array) -> None:
        """Read the episode that leads this trial."""
        number = trial.index if self._config.episode < 0 else self._config.episode
        if self._dataset is not None:
            self.demonstration = self._of_dataset(self._dataset, number)
        else:
            self.demonstration = self._of_file(number)
        joints_n = self.demonstration.q.shape[1]
        if joints_n != self._robot.dof:
            raise UsageError(
                f"the episode has {joints_n} joints, the arms have {self._robot.dof}",
                remedy="--set robot.arm=NAME of the arms that recorded it",
            )

    def _of_file(self, number: int) -> Demonstration:
        path = self._path
        if path.is_dir():
            paths = episode_paths(path)
            self._check_number(number, len(paths))
            path = paths[number]
        episode = read_episode(path, cameras=())
        return Demonstration(episode.meta.fps, episode.action, episode.action_gripper)

    def _of_dataset(self, dataset: LeRobotTables, number: int) -> Demonstration:
        self._check_number(number, len(dataset.starts))
        rows = slice(dataset.starts[number], dataset.stops[number])
        action = np.asarray(dataset.action[rows], dtype=float)
        return Demonstration(dataset.fps, action[:, :-2], action[:, -2:])

    def _check_number(self, number: int, count: int) -> None:
        if number >= count:
            raise UsageError(
                f"episode {number} of {self._path} does not exist; there are 0 to {count - 1}",
                remedy="--set teleop.replay.episode=N",
            )
