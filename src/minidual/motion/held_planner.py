"""Move an object that both hands hold to a new pose, round whatever stands in the way.

Three ways are tried, the fast one first: the object straight to its goal, both hands following; RRT-Connect over the
object's poses, the hands following by inverse kinematics; OMPL on the manifold of the grasp constraint. Whatever finds
a path, the same things happen to it then: made short, corners rounded, solved finely so that no hand strays, timed,
and proven with the object in the collision scene. Only what passes that proof is returned.
"""

from __future__ import annotations

import time
from collections import OrderedDict

import numpy as np

from minidual.collision.scene import PlanningScene
from minidual.config.planning import PlannerConfig
from minidual.errors import UsageError
from minidual.motion.closed_chain import CARRY_LIMITS
from minidual.motion.goals import PoseGoals
from minidual.motion.held_path import CarriedTrajectory, ObjectLimits
from minidual.motion.held_query import HeldQuery
from minidual.motion.held_work import HeldWork
from minidual.motion.timing import MotionLimits
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.constants import Array
from minidual.robot.kinematics import Kinematics

_SCENES_KEPT = 8


class HeldPlanner:
    """Plans moves of held objects. One instance a process: it holds workspaces.

    Args:
        limits: Limits of the joints' motion.
        object_limits: Speed and acceleration of the object.
        config: Padding, step and budget of the search.
    """

    def __init__(
        self,
        limits: MotionLimits | None = None,
        object_limits: ObjectLimits | None = None,
        config: PlannerConfig | None = None,
    ) -> None:
        self._limits = limits or CARRY_LIMITS
        self._object_limits = object_limits or ObjectLimits()
        self.config = config or PlannerConfig()
        self._kinematics = Kinematics()
        self._goals = PoseGoals()
        self._engines: OrderedDict[PlanningScene, SceneEngines] = OrderedDict()

    def engines(self, scene: PlanningScene) -> SceneEngines:
        """Return the engines of a scene, from the last few scenes or newly built."""
        if scene not in self._engines:
            self._engines[scene] = SceneEngines(scene)
            while len(self._engines) > _SCENES_KEPT:
                self._engines.popitem(last=False)
        self._engines.move_to_end(scene)
        return self._engines[scene]

    def plan(self, query: HeldQuery, budget_s: float | None = None) -> CarriedTrajectory:
        """Return a proven trajectory that brings the object to its goal.

        Args:
            query: The problem; the same query gives the same trajectory.
            budget_s: Wall time after which to give up; the configuration's by default.

        Raises:
            ClosedChainError: The hands are off their grasps at the start.
            StartInCollisionError, GoalInCollisionError: Start, or every posture found at the goal, touches something.
            IKUnreachableError: A hand cannot reach its grasp at the goal; with the residual.
            NoPathInTimeError: No path passed the proof; with what stopped the straight one and the last one.
            OutOfLimitsError, UsageError: Bad numbers.
        """
        query = query.checked()
        budget = self.config.budget_s if budget_s is None else budget_s
        if not (np.isfinite(budget) and budget > 0.0):
            raise UsageError(f"budget_s = {budget}; it must be a finite number > 0")
        return self._work(query, budget).run()

    def prove(self, query: HeldQuery, points: Array) -> CarriedTrajectory:
        """Return the proven trajectory along points that somebody else found.

        Args:
            query: The problem that the points solve.
            points: (n, 20), see `minidual.motion.held_space`, in the chart of the start's orientation.

        Raises:
            ClosedChainError, TimingError: The path through them cannot be followed, timed or proven.
        """
        return self._work(query.checked(), self.config.budget_s).prove(points)

    def _work(self, query: HeldQuery, budget_s: float) -> HeldWork:
        return HeldWork(
            query,
            self.engines(query.scene),
            self._kinematics,
            self._goals,
            self.config,
            self._limits,
            self._object_limits,
            time.perf_counter() + budget_s,
        )


__all__ = ["HeldPlanner", "HeldQuery"]
