"""Find the demonstrations at a path."""

from pathlib import Path

from minidual.demos.data.hdf5_source import Hdf5Source
from minidual.demos.data.lerobot_source import LeRobotSource
from minidual.demos.data.source import DataSource
from minidual.durable import expanded
from minidual.errors import UsageError
from minidual.robot.pair import Robot

_INFO = Path("meta/info.json")
_EPISODES = ("", "episodes", "teleop-record/episodes")
_DATASETS = ("", "lerobot", "teleop-record/lerobot")
"""Where episodes and datasets lie in their own folder, in a recording's, or in a run's."""
_ENDINGS = (".hdf5", ".h5")


def open_data(text: str, robot: Robot) -> DataSource:
    """Return the demonstrations at a path.

    A recording has both episodes and a dataset: the episodes are taken, which hold more.

    Args:
        text: A dataset, a recording, a run, a folder of HDF5 files, or one HDF5 file.
        robot: The arms that recorded HDF5 episodes of this program.

    Raises:
        UsageError: There are none.
        DataError: A dataset is damaged.
    """
    place = expanded(text)
    if place.is_file() and place.suffix in _ENDINGS:
        return Hdf5Source(place, [place], robot)
    for inner in _EPISODES:
        files = hdf5_files(place / inner)
        if files and not (place / inner / _INFO).is_file():
            return Hdf5Source(place / inner, files, robot)
    for inner in _DATASETS:
        if (place / inner / _INFO).is_file():
            return LeRobotSource(place / inner)
    if not place.exists():
        raise UsageError(
            f"there is nothing at {text}",
            remedy="name a file or folder on this machine: nothing is downloaded",
        )
    raise UsageError(
        f"{text} holds no demonstrations: neither {_INFO} nor files ending in .hdf5",
        remedy="name a LeRobot dataset, a recording, a run, or a folder of HDF5 episodes",
    )


def hdf5_files(folder: Path) -> list[Path]:
    """Return a folder's HDF5 files, without those that are being written."""
    if not folder.is_dir():
        return []
    return sorted(
        path
        for path in folder.iterdir()
        if path.suffix in _ENDINGS and not path.name.startswith(".")
    )
