"""Queries and paths for the tests of the bench."""

from __future__ import annotations

from functools import cache

import numpy as np

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box
from minidual.motion.api import Planner
from minidual.motion.blend import blended_path
from minidual.motion.search import EdgeChecker
from minidual.motion.timing import time_path
from minidual.robot.pair import SIDES, Array
from minidual.robot.trajectory import Trajectory
from scripts.bench.queries import GROUP, DrawnQuery, PosedQuery
from scripts.bench.query_sets import SETS
from tests.support.panda import HOME


@cache
def planner() -> Planner:
    """Return one planner for all tests of a process."""
    return Planner()


def posed_query(q_start: Array, q_goal: Array, scene: PlanningScene) -> PosedQuery:
    """Return a query between two postures (n,)."""
    tcp_poses = planner().kinematics.tcp_poses
    start = dict(zip(SIDES, tcp_poses(q_start), strict=True))
    goal = dict(zip(SIDES, tcp_poses(q_goal), strict=True))
    drawn = DrawnQuery(SETS["crossing"], 0, 1, scene, start, goal)
    return PosedQuery(drawn, "", q_start, q_goal)


def blocked_query() -> PosedQuery:
    """Return a query whose straight line runs through a box: the left arm turns past it."""
    q_start = HOME.copy()
    q_start[0] = 0.8
    q_goal = HOME.copy()
    q_goal[0] = -0.8
    post = Box("post", (0.34, 0.25, 0.4), size_m=(0.06, 0.06, 0.8))
    return posed_query(q_start, q_goal, PlanningScene().with_obstacles(post))


def straight(q_start: Array, q_goal: Array) -> Trajectory:
    """Return the timed straight line between two postures, whatever stands there."""
    nothing = planner().engines(PlanningScene(obstacles=()))
    ends = np.array([q_start, q_goal])
    checker = EdgeChecker(nothing, 0.0, ends, 0.1)
    curve = blended_path(ends, checker, 0.1, 0.1)
    return time_path(curve, GROUP, planner().config, planner().kinematics)[0]
