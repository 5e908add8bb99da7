"""Episodes of a LeRobot v3 dataset."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from minidual.demos.data.source import DataEpisode, DataSource, EpisodeReading, Image, force_sizes
from minidual.demos.lerobot_reader import read_dataset, read_signal


class LeRobotSource(DataSource):
    """A dataset.

    Raises:
        DataError: It is damaged, or holds what this program does not read.
    """

    kind = "LeRobot v3 dataset"

    def __init__(self, root: Path) -> None:
        self.root = root
        self.tables = read_dataset(root)
        self._instructions = self.tables.instructions()

    def __len__(self) -> int:
        return len(self.tables.starts)

    def episodes(self) -> Iterator[EpisodeReading]:
        """See `DataSource.episodes`."""
        tables = self.tables
        wrench = read_signal(self.root, "hand_wrench")
        internal = read_signal(self.root, "internal_force")
        for number, (start, stop) in enumerate(zip(tables.starts, tables.stops, strict=True)):
            rows = slice(int(start), int(stop))
            episode = DataEpisode(
                name=f"episode {number}",
                rate_hz=tables.fps,
                times_s=np.arange(stop - start) / tables.fps,
                state=tables.state[rows].astype(float),
                action=tables.action[rows].astype(float),
                state_names=tables.names,
                action_names=tables.action_names,
                cameras=tables.cameras,
                forces=force_sizes(
                    None if wrench is None else wrench[rows].astype(float),
                    None if internal is None else internal[rows].astype(float),
                ),
                task=self._instructions[number],
            )
            yield EpisodeReading(episode.name, episode)

    def cameras(self) -> tuple[str, ...]:
        """See `DataSource.cameras`."""
        return tuple(self.tables.cameras)

    def pictures(self, camera: str) -> Iterator[tuple[int, Image]]:
        """See `DataSource.pictures`."""
        tables = self.tables
        lengths = tables.stops - tables.starts
        gathered: list[Image] = []
        for row, image in tables.frames(camera):
            gathered.append(image)
            number = int(np.searchsorted(tables.starts, row, side="right")) - 1
            if len(gathered) == lengths[number]:
                yield number, np.stack(gathered)
                gathered = []
