"""A problem for the planner of held objects."""

from __future__ import annotations

from dataclasses import dataclass, replace

from minidual.collision.scene import PlanningScene
from minidual.motion.goals import check_joints
from minidual.motion.ik import check_pose
from minidual.robot.constants import Array


@dataclass(frozen=True, eq=False)
class HeldQuery:
    """One problem: where the arms are, what they hold and how, where it shall go, what stands round.

    Attributes:
        q_start: All 14 joints, both hands at their grasps.
        T_world_goal: Pose (4, 4) of the object at the goal.
        T_object_tcp_left, T_object_tcp_right: Grasps (4, 4).
        scene: Scene with the object in the hands (`scene_holding`).
        seed: Of the random numbers.
    """

    q_start: Array
    T_world_goal: Array
    T_object_tcp_left: Array
    T_object_tcp_right: Array
    scene: PlanningScene
    seed: int = 0

    def checked(self) -> HeldQuery:
        """Return the query with its arrays checked.

        Raises:
            OutOfLimitsError, UsageError: A bad start, goal or grasp.
        """
        return replace(
            self,
            q_start=check_joints(self.q_start, "start"),
            T_world_goal=check_pose(self.T_world_goal, "the goal of the object"),
            T_object_tcp_left=check_pose(self.T_object_tcp_left, "the left grasp"),
            T_object_tcp_right=check_pose(self.T_object_tcp_right, "the right grasp"),
        )
