"""Which topic holds which array of an episode."""

from minidual.demos.episode import Episode
from minidual.errors import DataError
from minidual.robot.pair import SIDES, Robot
from minidual.ros2.names import JOINT_COMMANDS, JOINT_STATES, image_topic

EPISODE = "/minidual/episode"
"""Attributes of the episode as JSON; first in the file."""
TICK_TIMES = "/minidual/tick_times"
"""Joint and image time of each tick [s], exact; stamps are rounded to nanoseconds."""
GRIPPER_STATES = "/gripper_states"
"""Openings of the left and right hand, from 0 (closed) to 1."""
GRIPPER_COMMANDS = "/gripper_commands"

ENCODING = "rgb8"


def gripper_names() -> list[str]:
    """Return the names of the two hands, in storage order."""
    return [f"{side}_gripper" for side in SIDES]


def camera_of(topic: str) -> str | None:
    """Return the camera of an image topic, or None for another topic."""
    before, _, after = image_topic("*").partition("*")
    if topic.startswith(before) and topic.endswith(after):
        return topic.removeprefix(before).removesuffix(after)
    return None


def check_joints(episode: Episode, robot: Robot) -> None:
    """Raise DataError if an episode has other joints than the robot."""
    joints_n = episode.qpos.shape[1]
    if joints_n != robot.dof:
        raise DataError(
            f"{episode.path} has {joints_n} joints; the arms '{robot.name}' have {robot.dof}",
            remedy="name the arm of the recording: --set robot.arm=NAME",
        )


NEEDED = (JOINT_STATES, JOINT_COMMANDS, GRIPPER_STATES, GRIPPER_COMMANDS)
"""Topics without which a file is no episode."""
