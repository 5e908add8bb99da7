"""Where the arms must be to grasp a rod, and smooth joint motion to get there and away."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from minidual.config.scene import SceneConfig
from minidual.control.object_path import minimum_jerk
from minidual.errors import MinidualError
from minidual.motion.ik import ArmIK
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot
from minidual.skills.phases import PHASES
from minidual.tasks.rod_carry import grasp_offsets


class GraspUnreachableError(MinidualError):
    """The hands cannot be placed on the rod where it lies."""


@functools.cache
def _solvers(robot: Robot) -> tuple[ArmIK, ...]:
    return tuple(ArmIK(side, Kinematics(robot)) for side in robot.sides)


def grasp_posture(
    scene: SceneConfig, robot: Robot, T_world_level: Array, q_near: Array, *, above_m: float = 0.0
) -> Array:
    """Return the joints (n,) that put both hands on the rod, or straight above their grasps.

    Args:
        scene: Holds the grasp on the rod.
        robot: Whose hands.
        T_world_level: Level pose (4, 4) of the rod.
        q_near: Posture (n,) to stay close to, so that the arms keep their configuration.
        above_m: Height of the hands over their grasps.

    Raises:
        GraspUnreachableError: No solution near q_near; the message names the residual.
    """
    q = np.array(q_near)
    for solver, T_rod_tcp in zip(_solvers(robot), grasp_offsets(scene), strict=True):
        T_world_tcp = T_world_level @ T_rod_tcp
        T_world_tcp[2, 3] += above_m
        columns = solver.joints
        solution = solver.solve(T_world_tcp, q_near[columns])
        if not solution.reached:
            x, y, z = T_world_tcp[:3, 3]
            raise GraspUnreachableError(
                f"the {solver.arm} hand misses its grasp at ({x:.3f}, {y:.3f}, {z:.3f}) m by "
                f"{1e3 * solution.residual_m:.1f} mm, {solution.residual_rad:.3f} rad",
                remedy="place the rod nearer to the bases, or turn it less",
            )
        q[columns] = solution.q
    return q


@dataclass(frozen=True)
class Quintic:
    """Rest-to-rest joint motion from q0 to q1, both (n,), in `duration_s`."""

    q0: Array
    q1: Array
    duration_s: float

    def at(self, t_s: float) -> tuple[Array, Array, Array]:
        """Return (q, v, a) at time t, each (n,); at rest before and after."""
        blend, rate, curvature = minimum_jerk(t_s / self.duration_s)
        delta = self.q1 - self.q0
        return (self.q0 + blend * delta, rate / self.duration_s * delta, curvature / self.duration_s**2 * delta)


def approach_postures(
    scene: SceneConfig, robot: Robot, T_world_level: Array, *, above_m: float = PHASES["approach"].rise_m
) -> tuple[Array, Array]:
    """Return (q over the rod, q at the grasp), each (n,), in the configuration of the home posture."""
    q_over = grasp_posture(scene, robot, T_world_level, robot.home, above_m=above_m)
    return q_over, grasp_posture(scene, robot, T_world_level, q_over)
