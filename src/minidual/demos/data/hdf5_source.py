"""HDF5 episodes of this program and of ALOHA."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import h5py
import numpy as np

from minidual.demos.data.aloha import aloha_pictures, is_aloha, read_aloha
from minidual.demos.data.source import DataEpisode, DataSource, EpisodeReading, Image, force_sizes
from minidual.demos.episode import Episode, inspect_episode, read_episode
from minidual.demos.lerobot_features import state_names
from minidual.errors import DataError
from minidual.robot.pair import Robot


class Hdf5Source(DataSource):
    """HDF5 files, one episode each.

    Args:
        root: The folder or the one file.
        paths: The files.
        robot: The arms, whose joint names and limits those of this program's episodes are.
    """

    def __init__(self, root: Path, paths: Sequence[Path], robot: Robot) -> None:
        self.root = root
        self.paths = tuple(paths)
        self._robot = robot
        self.is_own = not any(_is_aloha_file(path) for path in self.paths)
        self.kind = "HDF5 episodes" if self.is_own else "ALOHA HDF5 episodes"

    def __len__(self) -> int:
        return len(self.paths)

    def episodes(self) -> Iterator[EpisodeReading]:
        """See `DataSource.episodes`; those of this program bring every fault of their files."""
        for path in self.paths:
            if _is_aloha_file(path):
                with h5py.File(path, "r") as file:
                    yield read_aloha(file, path)
            else:
                yield self._own(path)

    def cameras(self) -> tuple[str, ...]:
        """See `DataSource.cameras`."""
        for reading in self.episodes():
            if reading.episode is not None:
                return tuple(reading.episode.cameras)
        return ()

    def pictures(self, camera: str) -> Iterator[tuple[int, Image]]:
        """See `DataSource.pictures`."""
        for number, path in enumerate(self.paths):
            images = self._images(path, camera)
            if images is not None:
                yield number, images

    def _images(self, path: Path, camera: str) -> Image | None:
        if _is_aloha_file(path):
            with h5py.File(path, "r") as file:
                reading = read_aloha(file, path)
                if reading.episode is None or camera not in reading.episode.cameras:
                    return None
                return aloha_pictures(file, camera)
        try:
            return read_episode(path, cameras=(camera,)).images[camera]
        except DataError:  # its faults are found with the episode
            return None

    def _own(self, path: Path) -> EpisodeReading:
        episode, faults = inspect_episode(path, robot=self._robot)
        if episode is None:
            return EpisodeReading(path.name, None, tuple(faults))
        return EpisodeReading(path.name, self._converted(episode, path.name), tuple(faults))

    def _converted(self, episode: Episode, name: str) -> DataEpisode:
        state = np.hstack([episode.qpos, episode.gripper])
        names = state_names(self._robot)
        if state.shape[1] != len(names):
            names = tuple(f"state_{k}" for k in range(state.shape[1]))
        return DataEpisode(
            name=name,
            rate_hz=episode.meta.fps,
            times_s=episode.timestamps - episode.timestamps[0],
            state=state,
            action=np.hstack([episode.action, episode.action_gripper]),
            state_names=names,
            action_names=names,
            cameras={
                camera: (images.shape[1], images.shape[2])
                for camera, images in episode.images.items()
            },
            effort=episode.effort,
            forces=force_sizes(
                episode.signals.get("hand_wrench"),
                episode.signals.get("internal_force"),
            ),
            success=episode.meta.success,
            task=episode.meta.task,
            facts=dict(episode.meta.extra),
        )


def _is_aloha_file(path: Path) -> bool:
    """Return whether a file has ALOHA's layout; a damaged one counts as this program's."""
    try:
        with h5py.File(path, "r") as file:
            return is_aloha(file)
    except Exception:  # h5py raises anything
        return False
