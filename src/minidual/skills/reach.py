"""Postures that grasp the object at its ends."""

from contextlib import suppress

import numpy as np

from minidual.config.scene import SceneConfig
from minidual.control.impedance_controllers import SLOW_AT
from minidual.errors import MinidualError, UsageError
from minidual.motion.ik import posture_at, solvers
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot
from minidual.skills.phases import raised
from minidual.tasks.task import grasp_offsets


class GraspUnreachableError(MinidualError):
    """The hands cannot reach their grasps."""


def posture_over(scene: SceneConfig, robot: Robot, T_world_level: Array, above_m: float) -> Array:
    """Return `grasp_posture` from home or, near a singularity, the posture nearest to home."""
    kinematics = Kinematics(robot)
    with suppress(GraspUnreachableError):
        over = grasp_posture(scene, robot, T_world_level, robot.home, above_m=above_m)
        postures = over, grasp_posture(scene, robot, T_world_level, over)
        hands = [J[:, robot.joints_of(arm)] for q in postures for arm, J in enumerate(kinematics.tcp_jacobians(q))]
        if np.linalg.cond(hands).max() < SLOW_AT[0]:
            return over
    left, right = (raised(T_world_level @ T, above_m) for T in grasp_offsets(scene))
    try:
        return posture_at(robot, (left, right), robot.home, robot.home)
    except UsageError as error:
        raise GraspUnreachableError(error.message, remedy=error.remedy) from error


def grasp_posture(
    scene: SceneConfig, robot: Robot, T_world_level: Array, q_near: Array, *, above_m: float = 0.0
) -> Array:
    """Return joints (n,) with both hands `above_m` over their grasps.

    `T_world_level` is the level object's pose; the search starts at `q_near` to keep the arms' configuration.

    Raises:
        GraspUnreachableError: No solution near `q_near`.
    """
    q = np.array(q_near)
    for solver, T_object_tcp in zip(solvers(robot).values(), grasp_offsets(scene), strict=True):
        T_world_tcp = raised(T_world_level @ T_object_tcp, above_m)
        solution = solver.solve(T_world_tcp, q_near[solver.joints])
        if not solution.reached:
            x, y, z = T_world_tcp[:3, 3]
            raise GraspUnreachableError(
                f"the {solver.arm} hand misses its grasp at ({x:.3f}, {y:.3f}, {z:.3f}) m by {solution.off}",
                remedy="place the object nearer to the bases, or turn it less",
            )
        q[solver.joints] = solution.q
    return q
