"""Closed-chain constraint and OMPL search on its manifold, the last resort.

F(q) = log6(E), E = T_world_left^-1 T_world_right T_left_right^-1, [linear; angular] in the left tcp
frame. With body Jacobians (Sola, "A micro Lie theory for state estimation in robotics", 2018):

    dF/dq = Jlog6(E) [ -Ad(E^-1) J_left,  Ad(T_left_right) J_right ]
"""

from typing import Any

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import pinocchio as pin

from minidual.motion.checks import check_pose
from minidual.motion.search import EdgeChecker, bounded_space, exact_path, seeded
from minidual.registry import Registry
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array

SPACES: Registry[Any] = Registry(
    "state space",
    {"atlas": ob.AtlasStateSpace, "projected": ob.ProjectedStateSpace},
)
_DELTA_RAD = 0.15
_BOX_RAD = 0.7
_RANGE = 1.0
_OMPL_TOLERANCE = 1e-4  # not finer: its states need another projection
_CALLS_A_CHECK = 20
"""Constraint evaluations allowed per state check."""


class GraspConstraint(ob.Constraint):
    """F(q) = 0 holds the right tcp at T_left_right (4, 4) in the left."""

    def __init__(self, T_left_right: Array, kinematics: Kinematics) -> None:
        super().__init__(kinematics.robot.dof, 6, _OMPL_TOLERANCE)
        self._kinematics = kinematics
        self.robot = kinematics.robot
        grasp = pin.SE3(check_pose(T_left_right, "the relative pose of the hands"))
        self._inverse = grasp.inverse()
        self._adjoint = grasp.action
        self.calls_n = 0

    def value_and_jacobian(self, q: Array) -> tuple[Array, Array]:
        """Return F (6,) [m, rad] and dF/dq (6, n)."""
        model = self._kinematics.model
        data = self._kinematics.data
        left_tcp, right_tcp = self._kinematics.tcp_ids
        pin.computeJointJacobians(model, data, q)
        left = pin.updateFramePlacement(model, data, left_tcp)
        right = pin.updateFramePlacement(model, data, right_tcp)
        E = left.actInv(right) * self._inverse
        J_left = pin.getFrameJacobian(model, data, left_tcp, pin.LOCAL)
        J_right = pin.getFrameJacobian(model, data, right_tcp, pin.LOCAL)
        J_error = self._adjoint @ J_right - E.actionInverse @ J_left
        return pin.log6(E).vector, pin.Jlog6(E) @ J_error

    def function(self, x: Any, out: Any) -> None:
        """Write F (6,), for OMPL."""
        self.calls_n += 1
        out[:] = self.value_and_jacobian(np.asarray(x))[0]

    def jacobian(self, x: Any, out: Any) -> None:
        """Write dF/dq, for OMPL."""
        out[:] = self.value_and_jacobian(np.asarray(x))[1]


def search_manifold(
    constraint: GraspConstraint,
    checker: EdgeChecker,
    q_start: Array,
    q_goal: Array,
    *,
    space: str,
    seed: int,
) -> Array | None:
    """Return configurations (m, n) on the manifold from start to goal, or None.

    F is below 1e-4 between them. Joints stay within 0.7 rad of the ends.

    Raises:
        UsageError: Unknown `space`.
    """
    seeded(seed)
    robot = constraint.robot
    low = np.maximum(np.minimum(q_start, q_goal) - _BOX_RAD, robot.q_lower)
    high = np.minimum(np.maximum(q_start, q_goal) + _BOX_RAD, robot.q_upper)
    states = SPACES[space](bounded_space(low, high), constraint)
    si = ob.ConstrainedSpaceInformation(states)
    states.setDelta(_DELTA_RAD)

    def joints(state: Any) -> Array:
        return np.array([state[i] for i in range(robot.dof)])

    si.setStateValidityChecker(lambda state: checker.free(joints(state)))
    si.setup()
    ends: list[Any] = [si.allocState(), si.allocState()]
    for state, q in zip(ends, (q_start, q_goal), strict=True):
        state.copy(np.array(q))
        if space == "atlas":
            states.anchorChart(state)
    # Most states may fail before the collision check, so constraint calls are limited too.
    checks_left = checker.checks_end - checker.checks_n
    calls_end = constraint.calls_n + _CALLS_A_CHECK * checks_left
    charged_n = constraint.calls_n

    def enough() -> bool:
        nonlocal charged_n
        checker.budget.spend(1 + constraint.calls_n - charged_n)
        charged_n = constraint.calls_n
        return checker.spent or constraint.calls_n >= calls_end

    path = exact_path(og.RRTConnect(si), _RANGE, ends, enough)
    if path is None:
        return None
    path.interpolate()
    return np.array([joints(path.getState(i)) for i in range(path.getStateCount())])
