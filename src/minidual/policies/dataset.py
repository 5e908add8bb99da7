"""From the LeRobot dataset on disk to demonstrations in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from minidual.demos.lerobot_reader import read_dataset
from minidual.errors import DataError
from minidual.policies.demonstrations import Demonstrations


def load_demonstrations(
    root: Path, cameras: Sequence[str], progress: Callable[[int], None] | None = None
) -> Demonstrations:
    """Read the dataset at `root` with the images of `cameras` (all of them when empty).

    `progress` is called with the number of images decoded since its last call.

    Raises:
        DataError: The dataset is missing or corrupt.
        UsageError: The dataset has no such camera.
    """
    if not root.is_dir():
        raise DataError(f"there is no dataset at {root}", remedy="minidual teleop-record --force")
    tables = read_dataset(root)
    wanted = sorted(cameras or tables.cameras)
    for camera in wanted:
        tables.size(camera)
    images = {camera: tables.images(camera, progress) for camera in wanted}
    return Demonstrations(images, tables.state, tables.action, tables.episode_index)
