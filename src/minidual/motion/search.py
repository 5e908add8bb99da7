"""The sampling search through OMPL: from start to goal as a polyline, or None.

Only an exact solution counts (`bool(status)` is true for an approximate one too). The search is limited by a
number of state checks, not by the clock, so that the same query and seed give the same path on any machine; the
clock only ends the query as a whole.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou

from minidual.motion.edges import EdgeChecker
from minidual.registry import Registry
from minidual.robot.pair import Array


def _tree(name: str) -> Callable[[Any, float], Any]:
    def make(si: Any, range_rad: float) -> Any:
        planner = getattr(og, name)(si)
        planner.setRange(range_rad)
        return planner

    return make


PLANNERS: Registry[Callable[[Any, float], Any]] = Registry(
    "planner",
    {
        "rrtconnect": _tree("RRTConnect"),
        "rrt": _tree("RRT"),
        "rrtstar": _tree("RRTstar"),
        "bitstar": lambda si, _range_rad: og.BITstar(si),
        "kpiece": _tree("KPIECE1"),
    },
)
"""OMPL's planners by the name that configuration uses. PRM is not among them: it asks from threads of its own whether
to stop, and waits for ever on a condition written in Python."""


class _Validity(ob.StateValidityChecker):
    def __init__(self, si: Any, free: Callable[[Any], bool]) -> None:
        super().__init__(si)
        self._free = free

    def isValid(self, state: Any) -> bool:
        return self._free(state)


class _Motion(ob.MotionValidator):
    def __init__(self, si: Any, edge_free: Callable[[Any, Any], bool]) -> None:
        super().__init__(si)
        self._edge_free = edge_free

    def checkMotion(self, s1: Any, s2: Any) -> bool:
        return self._edge_free(s1, s2)


def search(
    checker: EdgeChecker,
    q_start: Array,
    q_goal: Array,
    joints: slice,
    *,
    planner: str = "rrtconnect",
    range_rad: float = 1.0,
    seed: int,
    checks_max: int,
    deadline: float,
) -> Array | None:
    """Return a polyline (n, dof) from q_start to q_goal, both (dof,), or None.

    Args:
        checker: Collision checks with padding.
        q_start: Start; joints outside `joints` stay at its values.
        q_goal: Goal.
        joints: Joints that move.
        planner: A name of `PLANNERS`.
        range_rad: Longest edge of a tree, Euclidean in joint space.
        seed: Seed of OMPL's random numbers.
        checks_max: State checks after which the search gives up.
        deadline: time.perf_counter() at which it gives up whatever the count.
    """
    ou.setLogLevel(ou.LOG_NONE)  # setSeed complains on a second call although it does what it should
    ou.RNG.setSeed(1 + seed % (2**31 - 2))
    robot = checker.robot
    lower, upper = robot.q_lower[joints], robot.q_upper[joints]
    dof = len(lower)
    space = ob.RealVectorStateSpace(dof)
    bounds = ob.RealVectorBounds(dof)
    for i in range(dof):
        bounds.setLow(i, float(lower[i]))
        bounds.setHigh(i, float(upper[i]))
    space.setBounds(bounds)
    si = ob.SpaceInformation(space)
    indices = range(dof)

    def full(state: Any) -> Array:
        q = q_start.copy()
        q[joints] = [state[i] for i in indices]
        return q

    def edge_free(s1: Any, s2: Any) -> bool:
        return checker.edge_free(full(s1), full(s2))

    validity = _Validity(si, lambda state: checker.free(full(state)))
    motion = _Motion(si, edge_free)
    si.setStateValidityChecker(validity)
    si.setMotionValidator(motion)
    si.setup()
    problem = ob.ProblemDefinition(si)
    ends = []
    for q in (q_start, q_goal):
        state = si.allocState()
        for i, value in enumerate(q[joints]):
            state[i] = float(value)
        ends.append(state)
    problem.setStartAndGoalStates(ends[0], ends[1])
    objective = ob.PathLengthOptimizationObjective(si)
    objective.setCostThreshold(ob.Cost(float("inf")))  # the optimising planners stop at their first solution
    problem.setOptimizationObjective(objective)
    worker = PLANNERS[planner](si, range_rad)
    worker.setProblemDefinition(problem)
    worker.setup()
    checks_end = checker.checks_n + checks_max

    def enough() -> bool:
        return problem.hasExactSolution() or checker.checks_n >= checks_end or time.perf_counter() > deadline

    status = worker.solve(ob.PlannerTerminationCondition(enough))
    if status.getStatus() != ob.PlannerStatus.EXACT_SOLUTION:
        return None
    path = problem.getSolutionPath()
    return np.array([full(path.getState(i)) for i in range(path.getStateCount())])
