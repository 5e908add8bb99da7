"""The constraint of a closed chain, and OMPL on its manifold: the planner's last resort.

With E(q) = T_world_left^-1 T_world_right T_left_right^-1, the constraint is F(q) = log6(E), six numbers [linear;
angular] in the frame of the left hand, zero where the hands stand to each other as they grasped. The body velocity of
E is Ad(T_left_right) J_right dq - Ad(E^-1) J_left dq with the hands' Jacobians in their own frames, so

    dF/dq = Jlog6(E) [ -Ad(E^-1) J_left,  Ad(T_left_right) J_right ]

(Sola, "A micro Lie theory for state estimation in robotics", 2018: adjoints and the right Jacobian of the log).

What OMPL needs to work, measured: start and goal projected onto the manifold first; a space bounded to a box round
both ends; charts at both ends before the search. OMPL keeps F to 1e-4 at its states and less between them, so every
state is projected again afterwards.
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
"""Norm of F [m and rad together] at which a projected configuration counts as on the manifold."""
SPACES = {"atlas": ob.AtlasStateSpace, "projected": ob.ProjectedStateSpace}
_ITERATIONS = 30
_DAMPING = 1e-9
_DELTA_RAD = 0.15
_OMPL_TOLERANCE = 1e-4
_CALLS_A_CHECK = 20
"""Calls of the constraint that a search may make for every state check it may make."""


class GraspConstraint:
    """F(q) = 0 keeps the right hand at T_left_right in the frame of the left one.

    Args:
        T_left_right: Pose (4, 4) of the right tcp in the left tcp.
        kinematics: Workspace; one of its own by default.
    """

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
        """Return the constraint of two hands at their grasps on one object."""
        left = check_pose(T_object_tcp_left, "the left grasp")
        right = check_pose(T_object_tcp_right, "the right grasp")
        return cls(inverse(left) @ right, kinematics)

    def _offset(self, q: Array) -> pin.SE3:
        """Return E at q (n,)."""
        model, data = self._kinematics.model, self._kinematics.data
        pin.computeJointJacobians(model, data, q)
        left, right = (pin.updateFramePlacement(model, data, tcp) for tcp in self._kinematics.tcp_ids)
        return left.actInv(right) * self._inverse

    def value(self, q: Array) -> Array:
        """Return F (6,) at q (n,): metres, then radians."""
        return pin.log6(self._offset(q)).vector

    def value_and_jacobian(self, q: Array) -> tuple[Array, Array]:
        """Return F (6,) and dF/dq (6, n) at q (n,)."""
        E = self._offset(q)
        model, data = self._kinematics.model, self._kinematics.data
        left, right = (pin.getFrameJacobian(model, data, tcp, pin.LOCAL) for tcp in self._kinematics.tcp_ids)
        return pin.log6(E).vector, pin.Jlog6(E) @ (self._adjoint @ right - E.actionInverse @ left)

    def residual(self, q: Array) -> tuple[float, float]:
        """Return how far the hands are from their grasp at q (n,): ([m], [rad])."""
        E = self._offset(q)
        return float(np.linalg.norm(E.translation)), float(np.linalg.norm(pin.log3(E.rotation)))

    def project(self, q: Array, tolerance: float = TOLERANCE) -> Array | None:
        """Return the configuration (n,) near q on the manifold, inside the joint limits, or None.

        Newton steps of least norm, q <- q - J^T (J J^T)^-1 F; a joint that a step would push over its limit stays
        there and the others make up for it.
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
        """Return q (n,) projected onto the manifold.

        Raises:
            ClosedChainError: No configuration near q keeps the relative pose; with the residual.
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
    """Return the shortest step (n,) that takes F to zero to first order."""
    H = J @ J.T
    H.flat[:: len(H) + 1] += _DAMPING
    return -J.T @ np.linalg.solve(H, F)


class OmplGraspConstraint(ob.Constraint):
    """F(q) = 0 of a `GraspConstraint`, as OMPL wants it: written into its arrays in place."""

    def __init__(self, constraint: GraspConstraint) -> None:
        super().__init__(constraint.robot.dof, 6, _OMPL_TOLERANCE)
        self._constraint = constraint
        self.calls_n = 0

    def function(self, x: Any, out: Any) -> None:
        """Write F (6,) at x (n,) into out."""
        self.calls_n += 1
        out[:] = self._constraint.value(np.asarray(x))

    def jacobian(self, x: Any, out: Any) -> None:
        """Write dF/dq (6, n) at x (n,) into out."""
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
    """Return configurations (m, n) on the manifold from the start to one of the goals, or None.

    Args:
        constraint: The grasp.
        checker: Collision checks.
        q_start: Start (n,), on the manifold.
        q_goals: Goals (n,), tried one after the other; those that cannot be put on the manifold are left out.
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
        # Where hardly a state gets as far as a collision check, the projections count.
        spent = checker.checks_n >= checks_end or held.calls_n >= _CALLS_A_CHECK * checks_max
        return spent or time.perf_counter() > deadline

    path = exact_path(planner, problem, enough)
    if path is None:
        return None
    path.interpolate()
    points = [constraint.project(joints(path.getState(i))) for i in range(path.getStateCount())]
    return None if any(q is None for q in points) else np.array(points)
