"""Sampling search with OMPL.

Only exact solutions count (`bool(status)` is also true for approximate ones). Limits count state checks, so results do
not depend on the machine.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou

from minidual.config.seeds import subseed
from minidual.motion.edges import EdgeChecker
from minidual.registry import Registry
from minidual.robot.pair import Array

PLANNERS: Registry[Callable[[Any], Any]] = Registry("planner", {"rrtconnect": og.RRTConnect, "kpiece": og.KPIECE1})
"""OMPL planners. PRM hangs: it evaluates the termination condition in its own threads."""


class _Motion(ob.MotionValidator):
    def __init__(self, si: Any, edge_free: Callable[[Any, Any], bool]) -> None:
        super().__init__(si)
        self._edge_free = edge_free

    def checkMotion(self, s1: Any, s2: Any) -> bool:
        return self._edge_free(s1, s2)


def search(
    checker: EdgeChecker, ends: Array, joints: slice, *, seed: int, planner: str = "rrtconnect", range_rad: float = 1.0
) -> Array | None:
    """Return a polyline (n, dof) between configurations (2, dof), or None if the checker is spent.

    Only `joints` move. `range_rad`: longest tree edge (Euclidean).
    """
    ou.setLogLevel(ou.LOG_NONE)  # repeated setSeed logs an error
    ou.RNG.setSeed(max(1, subseed(seed, "ompl")))
    limits = np.column_stack([checker.robot.q_lower[joints], checker.robot.q_upper[joints]]).tolist()
    space, bounds = ob.RealVectorStateSpace(len(limits)), ob.RealVectorBounds(len(limits))
    for i, (low, high) in enumerate(limits):
        bounds.setLow(i, low)
        bounds.setHigh(i, high)
    space.setBounds(bounds)

    def full(state: Any) -> Array:
        q = ends[0].copy()
        q[joints] = [state[i] for i in range(len(limits))]
        return q

    si = ob.SpaceInformation(space)
    motion = _Motion(si, lambda s1, s2: checker.edge_free(full(s1), full(s2)))
    si.setStateValidityChecker(lambda state: checker.free(full(state)))
    si.setMotionValidator(motion)
    si.setup()
    states: list[Any] = [si.allocState(), si.allocState()]
    for state, q in zip(states, ends, strict=True):
        for i, value in enumerate(q[joints].tolist()):
            state[i] = value
    definition, worker = ob.ProblemDefinition(si), PLANNERS[planner](si)
    definition.setStartAndGoalStates(*states)
    worker.setRange(range_rad)
    worker.setProblemDefinition(definition)
    worker.setup()
    ended = ob.PlannerTerminationCondition(lambda: definition.hasExactSolution() or checker.spent)
    if worker.solve(ended).getStatus() != ob.PlannerStatus.EXACT_SOLUTION:
        return None
    path = definition.getSolutionPath()
    return np.array([full(path.getState(i)) for i in range(path.getStateCount())])
