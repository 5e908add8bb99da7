"""From the LeRobot dataset on disk to demonstrations in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from minidual.demos.lerobot_reader import IMAGE_PREFIX, camera_keys, read_dataset_to_ram, read_info
from minidual.errors import DataError, unknown_name
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.normalisation import image_key


def load_demonstrations(
    root: Path, cameras: Sequence[str], progress: Callable[[int, int], None] | None = None
) -> Demonstrations:
    """Read the dataset at `root`, decoding only `cameras` (names such as "high"; empty means all).

    Raises:
        DataError: the dataset is missing or corrupt.
        UsageError: the dataset has no such camera.
    """
    if not root.is_dir():
        raise DataError(f"there is no dataset at {root}", remedy="minidual teleop-record --force")
    prefix = f"{IMAGE_PREFIX}cam_"
    known = [key.removeprefix(prefix) for key in camera_keys(read_info(root))]
    for camera in cameras:
        if camera not in known:
            raise unknown_name("camera", camera, known)
    wanted = [image_key(camera) for camera in sorted(cameras or known)]
    ram = read_dataset_to_ram(root, cameras=wanted, progress=progress)
    images = {key.removeprefix(prefix): ram.images[key] for key in wanted}
    return Demonstrations(images, ram.state, ram.action, ram.episode_index)
