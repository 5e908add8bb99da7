"""Postures that grasp the object at its ends."""

from minidual.config.scene import SceneConfig
from minidual.errors import MinidualError, UsageError
from minidual.motion.ik import posture_at
from minidual.robot.pair import Array, Robot
from minidual.skills.phases import raised
from minidual.tasks.task import grasp_offsets


class GraspUnreachableError(MinidualError):
    """The hands cannot reach their grasps."""


def grasp_posture(
    scene: SceneConfig, robot: Robot, T_world_level: Array, q_near: Array, *, above_m: float = 0.0
) -> Array:
    """Return joints (n,) nearest to `q_near` with both hands `above_m` over their grasps.

    `T_world_level` is the level object's pose.

    Raises:
        GraspUnreachableError: A grasp is out of reach.
    """
    left, right = (raised(T_world_level @ T_object_tcp, above_m) for T_object_tcp in grasp_offsets(scene))
    try:
        return posture_at(robot, (left, right), q_near, q_near)
    except UsageError as error:
        raise GraspUnreachableError(error.message, remedy=error.remedy) from error
