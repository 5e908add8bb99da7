"""Plain OMPL and toppra on the queries of the bench.

RRTConnect asks MuJoCo every 0.03 rad; toppra times a spline through the simplified path.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import toppra
from toppra import algorithm, constraint

from minidual.config.planning import PlannerConfig
from minidual.motion.api import Planner
from minidual.motion.held.constraint import GraspConstraint
from minidual.motion.search import bounded_space, exact_path, seeded
from minidual.motion.timing import DT_S
from minidual.robot.pair import Array, Robot
from minidual.robot.trajectory import Trajectory
from scripts.bench.peers import PeerQuery, Run, evenly

_EDGE_RAD = 0.03
_SAME_RAD = 1e-9
"""Corners that are closer are one."""


def plan_ompl(query: PeerQuery, planner: Planner, budget_s: float) -> Run:
    """Plan with plain OMPL and toppra, within `budget_s` of processor time."""
    planner.engines(query.scene).engine("mujoco")  # built before; scenes are not timed
    began = time.process_time()
    corners = _search(query, planner, lambda: time.process_time() > began + budget_s)
    if corners is None:
        return Run(None, time.process_time() - began, "no path in time")
    timed = _timed(corners, query.group, planner.robot, planner.config)
    cpu_s = time.process_time() - began
    if timed is None:
        return Run(None, cpu_s, "toppra finds no timing")
    return Run(timed, cpu_s)


def _search(query: PeerQuery, planner: Planner, spent: Callable[[], bool]) -> Array | None:
    """Return a polyline (k, n) from start to goal; None if the time is `spent` first."""
    robot = planner.robot
    joints = robot.groups[query.group]
    dof = len(query.q_start[joints])
    engine = planner.engines(query.scene).engine("mujoco")
    seeded(query.seed)
    space = bounded_space(robot.q_lower[joints], robot.q_upper[joints])
    keeps_grasp = query.T_left_right is not None
    if query.T_left_right is not None:
        grasp = GraspConstraint(query.T_left_right, planner.kinematics)
        space = ob.ProjectedStateSpace(space, grasp)
        information = ob.ConstrainedSpaceInformation(space)
        space.setDelta(_EDGE_RAD)
    else:
        information = ob.SpaceInformation(space)

    def posture(state: Any) -> Array:
        q = query.q_start.copy()
        q[joints] = [state[i] for i in range(dof)]
        return q

    def is_free(state: Any) -> bool:
        return engine.contact_count(posture(state)) == 0

    def state_of(q: Array) -> Any:
        state: Any = information.allocState()
        if keeps_grasp:
            state.copy(np.array(q[joints]))
        else:
            for i, value in enumerate(q[joints]):
                state[i] = float(value)
        return state

    information.setStateValidityChecker(is_free)
    information.setStateValidityCheckingResolution(_EDGE_RAD / space.getMaximumExtent())
    information.setup()
    ends = [state_of(query.q_start), state_of(query.q_goal)]
    path = exact_path(og.RRTConnect(information), 0.0, ends, spent)
    if path is None:
        return None
    if not keeps_grasp:
        og.PathSimplifier(information).simplifyMax(path)
    path.interpolate()
    return np.array([posture(path.getState(i)) for i in range(path.getStateCount())])


def _timed(points: Array, group: str, robot: Robot, config: PlannerConfig) -> Trajectory | None:
    """Return the spline through points (k, n), timed by toppra."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    moves = np.append(True, steps > _SAME_RAD)
    points = points[moves]
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    s = np.append(0.0, np.cumsum(lengths))
    velocity = config.velocity_scale * np.stack([-robot.v_max, robot.v_max], axis=1)
    acceleration = config.acceleration_scale * np.stack([-robot.a_max, robot.a_max], axis=1)
    limits = [
        constraint.JointVelocityConstraint(velocity),
        constraint.JointAccelerationConstraint(acceleration),
    ]
    spline = toppra.SplineInterpolator(s, points)
    motion: Any = algorithm.TOPPRA(limits, spline).compute_trajectory(0.0, 0.0)
    if motion is None:
        return None
    times = np.append(np.arange(0.0, motion.duration, DT_S), motion.duration)
    return evenly(times, motion(times, 0), motion(times, 1), motion(times, 2), group)
