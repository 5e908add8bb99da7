"""Closed-chain constraint and OMPL search on its manifold, the last resort.

F(q) = log6(E), E = T_world_left^-1 T_world_right T_left_right^-1, [linear; angular] in the left tcp frame. With body
Jacobians (Sola, "A micro Lie theory for state estimation in robotics", 2018):

    dF/dq = Jlog6(E) [ -Ad(E^-1) J_left,  Ad(T_left_right) J_right ]

OMPL needs (measured) both ends on the manifold, a box around them, and charts at them. It keeps F only to 1e-4, so
states are projected again.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import pinocchio as pin

from minidual.collision.errors import ClosedChainError
from minidual.errors import unknown_name
from minidual.motion.edges import EdgeChecker
from minidual.motion.ik import check_pose
from minidual.motion.search import Validity, bounded_space, exact_path, seeded
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.robot.poses import inverse

TOLERANCE = 1e-9
"""Norm of F (m and rad combined) that counts as zero."""
SPACES = {"atlas": ob.AtlasStateSpace, "projected": ob.ProjectedStateSpace}
_ITERATIONS = 30
_DAMPING = 1e-9
_DELTA_RAD = 0.15
_OMPL_TOLERANCE = 1e-4
_CALLS_A_CHECK = 20
"""Constraint evaluations allowed per state check."""


class GraspConstraint:
    """F(q) = 0 holds the right tcp at T_left_right (4, 4) in the left."""

    def __init__(self, T_left_right: Array, kinematics: Kinematics | None = None) -> None:
        grasp = pin.SE3(check_pose(T_left_right, "the relative pose of the hands"))
        self._inverse = grasp.inverse()
        self._adjoint = grasp.action
        self._kinematics = kinematics or Kinematics()
        self.robot = self._kinematics.robot

    @classmethod
    def from_grasps(
        cls, T_object_tcp_left: Array, T_object_tcp_right: Array, kinematics: Kinematics | None = None
    ) -> GraspConstraint:
        """Return the constraint of two grasps."""
        left = check_pose(T_object_tcp_left, "the left grasp")
        right = check_pose(T_object_tcp_right, "the right grasp")
        return cls(inverse(left) @ right, kinematics)

    def _offset(self, q: Array) -> pin.SE3:
        model, data = self._kinematics.model, self._kinematics.data
        pin.computeJointJacobians(model, data, q)
        left, right = (pin.updateFramePlacement(model, data, tcp) for tcp in self._kinematics.tcp_ids)
        return left.actInv(right) * self._inverse

    def value(self, q: Array) -> Array:
        """Return F (6,) [m, rad]."""
        return pin.log6(self._offset(q)).vector

    def value_and_jacobian(self, q: Array) -> tuple[Array, Array]:
        """Return F (6,) and dF/dq (6, n)."""
        E = self._offset(q)
        model, data = self._kinematics.model, self._kinematics.data
        left, right = (pin.getFrameJacobian(model, data, tcp, pin.LOCAL) for tcp in self._kinematics.tcp_ids)
        return pin.log6(E).vector, pin.Jlog6(E) @ (self._adjoint @ right - E.actionInverse @ left)

    def residual(self, q: Array) -> tuple[float, float]:
        """Return the relative pose error ([m], [rad])."""
        E = self._offset(q)
        return float(np.linalg.norm(E.translation)), float(np.linalg.norm(pin.log3(E.rotation)))

    def project(self, q: Array, tolerance: float = TOLERANCE) -> Array | None:
        """Return a nearby configuration (n,) on the manifold within the limits, or None.

        Least-norm Newton steps; joints pushed against a limit stay.
        """
        lower, upper = self.robot.q_lower, self.robot.q_upper
        q = np.clip(np.asarray(q, dtype=float), lower, upper)
        for _ in range(_ITERATIONS):
            F, J = self.value_and_jacobian(q)
            if not np.isfinite(F).all():
                return None
            if tolerance**2 > F @ F:
                return q
            step = _least_norm(J, F)
            over = ((q <= lower) & (step < 0.0)) | ((q >= upper) & (step > 0.0))
            if over.any():
                step = _least_norm(np.where(over, 0.0, J), F)
            q = np.clip(q + step, lower, upper)
        return None

    def require(self, q: Array, what: str) -> Array:
        """Return q projected onto the manifold.

        Raises:
            ClosedChainError: The projection failed.
        """
        projected = self.project(q)
        if projected is None:
            distance, angle = self.residual(q)
            raise ClosedChainError(
                f"the {what} cannot keep the relative pose of the hands: they are {distance * 1e3:.2f} mm and "
                f"{angle:.4f} rad from it, and no configuration near it inside the joint limits mends that",
                remedy="take the grasps from the hands as they are (grasp_of), or choose another configuration",
            )
        return projected


def _least_norm(J: Array, F: Array) -> Array:
    """Return the shortest step (n,) that zeroes F to first order."""
    H = J @ J.T
    H.flat[:: len(H) + 1] += _DAMPING
    return -J.T @ np.linalg.solve(H, F)


class OmplGraspConstraint(ob.Constraint):
    """`GraspConstraint` for OMPL."""

    def __init__(self, constraint: GraspConstraint) -> None:
        super().__init__(constraint.robot.dof, 6, _OMPL_TOLERANCE)
        self._constraint = constraint
        self.calls_n = 0

    def function(self, x: Any, out: Any) -> None:
        """Write F (6,) to out."""
        self.calls_n += 1
        out[:] = self._constraint.value(np.asarray(x))

    def jacobian(self, x: Any, out: Any) -> None:
        """Write dF/dq to out."""
        out[:] = self._constraint.value_and_jacobian(np.asarray(x))[1]


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
    """Return configurations (m, n) on the manifold from the start to a goal, or None.

    Goals (n,) are tried in order, `checks_max` each. Joints stay within `box_rad` of the ends.

    Raises:
        UsageError: Unknown `space`.
        ClosedChainError: The start cannot be projected.
    """
    if space not in SPACES:
        raise unknown_name("constrained space", space, SPACES)
    seeded(seed)
    q_start = constraint.require(q_start, "start")
    for goal in map(constraint.project, q_goals):
        if time.perf_counter() > deadline:
            return None
        if goal is not None:
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
    robot = constraint.robot
    low = np.maximum(np.minimum(start, goal) - box_rad, robot.q_lower)
    high = np.minimum(np.maximum(start, goal) + box_rad, robot.q_upper)
    held = OmplGraspConstraint(constraint)
    space = SPACES[space_name](bounded_space(low, high), held)
    si = ob.ConstrainedSpaceInformation(space)
    space.setDelta(_DELTA_RAD)

    def joints(state: Any) -> Array:
        return np.array([state[i] for i in range(robot.dof)])

    validity = Validity(si, lambda state: checker.free(joints(state)))
    si.setStateValidityChecker(validity)
    si.setup()
    problem = ob.ProblemDefinition(si)
    states = []
    for q in (start, goal):
        state: Any = si.allocState()
        state.copy(np.array(q))
        if space_name == "atlas":
            space.anchorChart(state)
        states.append(state)
    problem.setStartAndGoalStates(states[0], states[1])
    planner = og.RRTConnect(si)
    planner.setRange(1.0)
    checks_end = checker.checks_n + checks_max

    def enough() -> bool:
        # Most states may fail before the collision check, so constraint calls are limited too.
        spent = checker.checks_n >= checks_end or held.calls_n >= _CALLS_A_CHECK * checks_max
        return spent or time.perf_counter() > deadline

    path = exact_path(planner, problem, enough)
    if path is None:
        return None
    path.interpolate()
    points = [constraint.project(joints(path.getState(i))) for i in range(path.getStateCount())]
    return None if any(q is None for q in points) else np.array(points)
