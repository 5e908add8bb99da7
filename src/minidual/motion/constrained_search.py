"""The fallback: OMPL plans on the manifold of our own grasp constraint (atlas charts, or projection).

`ob.Constraint` gets F and its analytic Jacobian from `GraspConstraint`. What made it work, measured: project start and
goal onto the manifold first; bound the space to a box round both ends; charts at both ends before the search. OMPL
keeps F to 1e-4 at its states and less between them, so every state is projected again afterwards.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou

from minidual.errors import unknown_name
from minidual.motion.edges import EdgeChecker
from minidual.motion.grasp_constraint import GraspConstraint
from minidual.robot.constants import DOF, Q_LOWER, Q_UPPER, Array

SPACES = ("atlas", "projected")
_DELTA_RAD = 0.15
_TOLERANCE = 1e-4
_CALLS_A_CHECK = 20
"""Calls of the constraint that a search may make for every state check it may make."""


class OmplGraspConstraint(ob.Constraint):
    """F(q) = 0 of a `GraspConstraint`, as OMPL wants it: written into its arrays in place."""

    def __init__(self, constraint: GraspConstraint) -> None:
        super().__init__(DOF, 6, _TOLERANCE)
        self._constraint = constraint
        self.calls_n = 0

    def function(self, x: Any, out: Any) -> None:
        """Write F (6,) at x (14,) into out."""
        self.calls_n += 1
        out[:] = self._constraint.value(np.asarray(x))

    def jacobian(self, x: Any, out: Any) -> None:
        """Write dF/dq (6, 14) at x (14,) into out."""
        out[:] = self._constraint.jacobian(np.asarray(x))


class _Validity(ob.StateValidityChecker):
    def __init__(self, si: Any, free: Callable[[Any], bool]) -> None:
        super().__init__(si)
        self._free = free

    def isValid(self, state: Any) -> bool:
        return self._free(state)


def search_manifold(
    constraint: GraspConstraint,
    checker: EdgeChecker,
    q_start: Array,
    q_goals: Sequence[Array],
    *,
    space: str,
    box_rad: float,
    seed: int,
    checks_max: int,
    deadline: float,
) -> Array | None:
    """Return configurations (n, 14) on the manifold from the start to one of the goals, or None.

    Args:
        constraint: The grasp.
        checker: Collision checks.
        q_start: Start (14,), on the manifold.
        q_goals: Goals (14,), on the manifold; tried one after the other, those that cannot be put on it left out.
        space: A name of `SPACES`.
        box_rad: How far beyond the two ends every joint may go.
        seed: Seed of OMPL's random numbers.
        checks_max: State checks of one goal.
        deadline: time.perf_counter() at which to give up whatever the count.

    Raises:
        UsageError: No such space.
        ClosedChainError: The start cannot keep the relative pose.
    """
    if space not in SPACES:
        raise unknown_name("constrained space", space, SPACES)
    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(1 + seed % (2**31 - 2))
    q_start = constraint.require(q_start, "start")
    for q_goal in q_goals:
        if time.perf_counter() > deadline:
            return None
        goal = constraint.project(q_goal)
        if goal is None:
            continue  # another posture may do
        path = _search(constraint, checker, q_start, goal, space, box_rad, checks_max, deadline)
        if path is not None:
            return path
    return None


def _search(
    constraint: GraspConstraint,
    checker: EdgeChecker,
    start: Array,
    goal: Array,
    space_name: str,
    box_rad: float,
    checks_max: int,
    deadline: float,
) -> Array | None:
    ambient = ob.RealVectorStateSpace(DOF)
    bounds = ob.RealVectorBounds(DOF)
    low = np.maximum(np.minimum(start, goal) - box_rad, Q_LOWER)
    high = np.minimum(np.maximum(start, goal) + box_rad, Q_UPPER)
    for i in range(DOF):
        bounds.setLow(i, float(low[i]))
        bounds.setHigh(i, float(high[i]))
    ambient.setBounds(bounds)
    held = OmplGraspConstraint(constraint)
    if space_name == "atlas":
        space = ob.AtlasStateSpace(ambient, held)
        si = ob.ConstrainedSpaceInformation(space)
    else:
        space = ob.ProjectedStateSpace(ambient, held)
        si = ob.ConstrainedSpaceInformation(space)
    space.setDelta(_DELTA_RAD)

    def joints(state: Any) -> Array:
        return np.array([state[i] for i in range(DOF)])

    validity = _Validity(si, lambda state: checker.free(joints(state)))
    si.setStateValidityChecker(validity)
    si.setup()
    problem = ob.ProblemDefinition(si)
    states = []
    for q in (start, goal):
        state = si.allocState()
        state.copy(np.array(q))
        if space_name == "atlas":
            space.anchorChart(state)
        states.append(state)
    problem.setStartAndGoalStates(states[0], states[1])
    planner = og.RRTConnect(si)
    planner.setRange(1.0)
    planner.setProblemDefinition(problem)
    planner.setup()
    checks_end = checker.checks_n + checks_max

    def enough() -> bool:
        # Where hardly a state gets as far as a collision check, the projections count.
        spent = checker.checks_n >= checks_end or held.calls_n >= _CALLS_A_CHECK * checks_max
        return problem.hasExactSolution() or spent or time.perf_counter() > deadline

    status = planner.solve(ob.PlannerTerminationCondition(enough))
    if status.getStatus() != ob.PlannerStatus.EXACT_SOLUTION:
        return None
    path = problem.getSolutionPath()
    path.interpolate()
    points = [constraint.project(joints(path.getState(i))) for i in range(path.getStateCount())]
    return None if any(q is None for q in points) else np.array(points)
