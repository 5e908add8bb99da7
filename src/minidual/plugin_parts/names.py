"""Names of joints, grippers and cameras in LeRobot's dictionaries and datasets."""

from minidual.errors import UsageError, check_name
from minidual.plant.cameras import CAMERAS
from minidual.robot.pair import Robot

POSITION = ".pos"
"""Ending of every joint and gripper, as LeRobot's own robots have it."""
_CAMERA = "cam_"
"""As in the datasets of `teleop-record`: `observation.images.cam_high`."""


def position_names(robot: Robot) -> tuple[str, ...]:
    """Return the names of joints [rad], then of grippers (0 closed to 1 open)."""
    grippers = [f"{side}_gripper" for side in robot.sides]
    return tuple(f"{name}{POSITION}" for name in (*robot.joint_names, *grippers))


def camera_name(view: str) -> str:
    """Return LeRobot's name of a camera: "cam_high" of "high"."""
    return _CAMERA + view


def check_views(views: tuple[str, ...]) -> tuple[str, ...]:
    """Return views, each a camera of the scene.

    Raises:
        UsageError: Another name, or one twice.
    """
    for view in views:
        check_name("camera", view, CAMERAS)
    if len(set(views)) < len(views):
        raise UsageError(f"views repeat: {', '.join(views)}")
    return views
