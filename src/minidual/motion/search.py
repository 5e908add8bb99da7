"""Sampling search with OMPL.

Only exact solutions count (`bool(status)` is also true for approximate ones). Limits count state checks, so results do
not depend on the machine.
"""

from collections.abc import Callable, Sequence
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


def bounded_space(lower: Array, upper: Array) -> Any:
    """Return OMPL's space within limits (d,)."""
    space, bounds = ob.RealVectorStateSpace(len(lower)), ob.RealVectorBounds(len(lower))
    for i, (low, high) in enumerate(zip(lower.tolist(), upper.tolist(), strict=True)):
        bounds.setLow(i, low)
        bounds.setHigh(i, high)
    space.setBounds(bounds)
    return space


def seeded(seed: int) -> None:
    """Seed OMPL and silence it: repeated setSeed logs an error."""
    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(max(1, subseed(seed, "ompl")))


def exact_path(worker: Any, range_rad: float, ends: Sequence[Any], enough: Callable[[], bool]) -> Any:
    """Return the exact solution between two states, or None if `enough` came first."""
    definition = ob.ProblemDefinition(worker.getSpaceInformation())
    definition.setStartAndGoalStates(*ends)
    worker.setRange(range_rad)
    worker.setProblemDefinition(definition)
    worker.setup()
    ended = ob.PlannerTerminationCondition(lambda: definition.hasExactSolution() or enough())
    status = worker.solve(ended)
    return definition.getSolutionPath() if status.getStatus() == ob.PlannerStatus.EXACT_SOLUTION else None


def search(
    checker: EdgeChecker, ends: Array, joints: slice, *, seed: int, planner: str = "rrtconnect", range_rad: float = 1.0
) -> Array | None:
    """Return a polyline (n, dof) between configurations (2, dof), or None if the checker is spent.

    Only `joints` move. `range_rad`: longest tree edge (Euclidean).
    """
    seeded(seed)
    robot = checker.robot
    si = ob.SpaceInformation(bounded_space(robot.q_lower[joints], robot.q_upper[joints]))
    indices = range(len(ends[0, joints]))

    def full(state: Any) -> Array:
        q = ends[0].copy()
        q[joints] = [state[i] for i in indices]
        return q

    motion = _Motion(si, lambda s1, s2: checker.edge_free(full(s1), full(s2)))
    si.setStateValidityChecker(lambda state: checker.free(full(state)))
    si.setMotionValidator(motion)
    si.setup()
    states: list[Any] = [si.allocState(), si.allocState()]
    for state, q in zip(states, ends, strict=True):
        for i, value in enumerate(q[joints]):
            state[i] = float(value)
    path = exact_path(PLANNERS[planner](si), range_rad, states, lambda: checker.spent)
    return None if path is None else np.array([full(path.getState(i)) for i in range(path.getStateCount())])
