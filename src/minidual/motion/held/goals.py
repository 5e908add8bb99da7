"""Goal postures of a held object."""

import numpy as np

from minidual.collision.errors import ClosedChainError, PlanningError
from minidual.config.planning import PlannerConfig
from minidual.config.seeds import stream
from minidual.motion.checks import place_text
from minidual.motion.held.hands import HandsIK
from minidual.motion.held.query import HeldQuery
from minidual.motion.pose_goals import pose_goals
from minidual.proof.scene_engines import SceneEngines
from minidual.robot.pair import SIDES, Array

_LIMIT_ROOM_RAD = 1e-4
_CANDIDATES_N = 400
_SAME_RAD = 0.5
"""Postures closer than this are duplicates."""


class GoalSearch:
    """Looks for free postures of both arms at an object's goal."""

    def __init__(
        self,
        query: HeldQuery,
        hands: HandsIK,
        engines: SceneEngines,
        config: PlannerConfig,
    ) -> None:
        self.query = query
        self.hands = hands
        self.engines = engines
        self.config = config

    def postures(
        self,
        straight_end: Array | None,
        count: int,
        restarts_scale: int = 1,
    ) -> list[Array]:
        """Return free goal postures (n,): the end of the straight motion first, then the nearest.

        Args:
            straight_end: Joints at the end of the straight motion (n,), or None.
            count: Most postures.
            restarts_scale: Multiple of the usual IK restarts.

        Raises:
            IKUnreachableError, GoalInCollisionError: None exists.
            ClosedChainError: All lie at limits.
        """
        candidates = self._candidates(straight_end, count, restarts_scale)
        postures: list[Array] = []
        for candidate in candidates:
            if len(postures) >= count:
                break
            q = self._off_limits(candidate)
            if q is not None and all(np.abs(q - other).max() > _SAME_RAD for other in postures):
                postures.append(q)
        if not postures:
            where = place_text(self.query.T_world_goal)
            raise ClosedChainError(
                f"every posture found for the goal at {where} lies at a joint limit",
                remedy="move the goal nearer to the middle, or choose another grasp",
            )
        return postures

    def _candidates(
        self,
        straight_end: Array | None,
        count: int,
        restarts_scale: int,
    ) -> list[Array]:
        candidates: list[Array] = []
        if straight_end is not None and self.engines.solids.free(straight_end):
            candidates.append(straight_end)
        roomy = bool(candidates) and not self.engines.closest(candidates[0], self.config.padding_m)
        if roomy and count == 1:
            return candidates
        try:
            candidates += self._solved(1 if count == 1 else _CANDIDATES_N, restarts_scale)
        except PlanningError:
            if not candidates:
                raise
        return candidates

    def _solved(self, count: int, restarts_scale: int) -> list[Array]:
        query = self.query
        targets = {
            arm: query.T_world_goal @ grasp
            for arm, grasp in zip(SIDES, self.hands.grasps, strict=True)
        }
        return pose_goals(
            "both_arms",
            query.q_start,
            targets,
            self.engines,
            stream(query.seed, "held/goals"),
            restarts_scale * self.config.ik_restarts_n,
            count,
        )

    def _off_limits(self, q: Array) -> Array | None:
        """Return a posture near q (n,) that is away from joint limits, or None."""
        hands = self.hands
        T_goal = self.query.T_world_goal
        lowest = hands.robot.q_lower + _LIMIT_ROOM_RAD
        highest = hands.robot.q_upper - _LIMIT_ROOM_RAD
        solved = hands.solve(T_goal, np.clip(q, lowest, highest))
        if solved is None:
            return None
        relaxed = hands.relaxed(T_goal, solved)
        return relaxed if self.engines.solids.free(relaxed) else solved
