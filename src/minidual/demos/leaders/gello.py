"""A pair of GELLO arms leads."""

from contextlib import ExitStack, closing
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from minidual.config.leading import GelloConfig
from minidual.demos.leader import Features, Leader, LeaderSample, LeaderSetup
from minidual.demos.leaders.dynamixel_bus import BusReader, DynamixelBus
from minidual.demos.leaders.gello_file import GelloFile, read_gello_file
from minidual.robot.pair import SIDES, Robot


class GelloLeader(Leader):
    """Gives the joints of two chains of servos.

    Raises:
        ConfigError: The file does not fit.
        EnvironmentMissingError: A port is missing, or a servo does not answer.
    """

    features: ClassVar[Features] = Features(targets="joints", realtime=True)
    usage: ClassVar[str] = (
        "gello: bring both leader arms to the posture of the arms, then start; "
        "the arms hold until each joint agrees"
    )

    def __init__(self, gello: GelloFile, silence_max_s: float) -> None:
        self._gello = gello
        self._silence_max_s = silence_max_s
        with ExitStack() as stack:
            self._readers = [
                stack.enter_context(
                    closing(BusReader(DynamixelBus(arm.port, gello.baud_rate, arm.servos))),
                )
                for arm in gello.arms
            ]
            self._opened = stack.pop_all()

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        """Open the ports of the file."""
        config: GelloConfig = setup.config.gello
        return cls(read_file(setup.robot, config), config.silence_max_s)

    @property
    def hint(self) -> str:
        """Which chain is gone, and how many readings were lost."""
        texts: list[str] = []
        for side, reader in zip(SIDES, self._readers, strict=True):
            if reader.failure:
                texts.append(f"the {side} chain is gone: {reader.failure}")
        return ", ".join(texts)

    @property
    def lost_n(self) -> int:
        """Readings that were lost so far."""
        return sum(reader.lost_n for reader in self._readers)

    def read(self, now_s: float) -> LeaderSample | None:
        """Return the newest joints of both; None if one has been silent too long."""
        joints: list[np.ndarray] = []
        openings: list[float] = []
        oldest_s = 0.0
        for arm, reader in zip(self._gello.arms, self._readers, strict=True):
            angles, age_s = reader.newest()
            if angles is None or age_s > self._silence_max_s:
                return None
            joints.append(arm.joints(angles))
            openings.append(arm.opening(angles))
            oldest_s = max(oldest_s, age_s)
        return LeaderSample(np.array(openings), q=np.concatenate(joints), age_s=oldest_s)

    def close(self) -> None:
        """Free the ports."""
        self._opened.close()


def read_file(robot: Robot, config: GelloConfig) -> GelloFile:
    """Return the file of the settings."""
    return read_gello_file(Path(config.file), robot)
