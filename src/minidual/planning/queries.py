"""Seeded planning queries: two collision-free configurations round a table with obstacles.

Each query has its own scene of boxes and cylinders on the table. Start and goal are tcp poses over the table, hands
down within a tilt, solved by inverse kinematics to free configurations with room round them. Of a stated share
of the queries the straight line in joint space is blocked. Nothing here plans: whether a query is solved is the
planner's business alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minidual.planning.edges import EdgeChecker
from minidual.planning.errors import PlanningError
from minidual.planning.goals import group_arms
from minidual.planning.ik import ArmIK
from minidual.planning.mujoco_engine import MujocoEngine
from minidual.planning.scene import TABLE, PlanningScene
from minidual.planning.shapes import Box, Cylinder, Shape
from minidual.robot.constants import ARMS, BASE_POSITIONS_M, GROUPS, HOME, Array
from minidual.robot.poses import pose, rot_x, rot_z

_ROOM_M = 0.01
_TILT_RAD = 0.6
_IK_STARTS_N = 6
_POSE_TRIES_N = 60
_STEP_RAD = 0.05
_SCENE_TRIES_N = 40


@dataclass(frozen=True, eq=False)
class Query:
    """One planning problem.

    Attributes:
        group: Planning group.
        index: Number within the group.
        seed: Seed for the planner.
        scene: Table and obstacles.
        q_start: Free start (14,) [rad].
        q_goal: Free goal (14,), a witness that the poses can be reached.
        targets: Tcp poses of the group's arms at the goal.
        as_poses: Whether the planner is given the poses (and does its own IK) or the joints.
        blocked: Whether the straight line from start to goal touches something.
    """

    group: str
    index: int
    seed: int
    scene: PlanningScene
    q_start: Array
    q_goal: Array
    targets: dict[str, Array]
    as_poses: bool
    blocked: bool


class QueryGenerator:
    """Makes the queries of a seed; the same seed and index always give the same query.

    Args:
        seed: Seed of the set.
        obstacles_n: Obstacles of each query.
        blocked_fraction: Share of the queries whose straight line must be blocked.
    """

    def __init__(self, seed: int, obstacles_n: int = 5, blocked_fraction: float = 0.75) -> None:
        self._seed = seed
        self._obstacles_n = obstacles_n
        self._blocked_fraction = blocked_fraction
        self._ik = {arm: ArmIK(arm) for arm in ARMS}

    def query(self, group: str, index: int) -> Query:
        """Return query `index` of a group: even ones give joints as the goal, odd ones poses.

        Raises:
            UsageError: Unknown group.
            PlanningError: No such query exists for these settings (too many obstacles, say).
        """
        arms = group_arms(group)
        rng = np.random.default_rng([self._seed, list(GROUPS).index(group), index])
        want_blocked = int((index + 1) * self._blocked_fraction) > int(index * self._blocked_fraction)
        for _ in range(_SCENE_TRIES_N):
            scene = PlanningScene(obstacles=(TABLE, *random_obstacles(rng, self._obstacles_n)))
            engine = MujocoEngine(scene)
            for _ in range(4):
                start = self._configuration(rng, engine, HOME, ARMS)
                goal = None if start is None else self._configuration(rng, engine, start, arms)
                if start is None or goal is None:
                    continue
                line = EdgeChecker(engine, 0.0, (), _STEP_RAD)
                blocked = not line.edge_free(start, goal)
                if want_blocked and not blocked:
                    continue
                targets = {arm: self._ik[arm].tcp_pose(goal[GROUPS[f"{arm}_arm"]]) for arm in arms}
                seed = int(rng.integers(2**31))
                return Query(group, index, seed, scene, start, goal, targets, index % 2 == 1, blocked)
        raise PlanningError(
            f"no query {index} for {group} with {self._obstacles_n} obstacles after {_SCENE_TRIES_N} scenes",
            remedy="use fewer obstacles or a smaller blocked_fraction",
        )

    def _configuration(
        self, rng: np.random.Generator, engine: MujocoEngine, q_base: Array, arms: tuple[str, ...]
    ) -> Array | None:
        """Return a free configuration whose `arms` reach random poses, the other joints as in q_base; or None."""
        for _ in range(_POSE_TRIES_N):
            q = np.array(q_base)
            for arm in arms:
                solution = self._reach(rng, arm, random_pose(rng, arm))
                if solution is None:
                    break
                q[GROUPS[f"{arm}_arm"]] = solution
            else:
                if not engine.closest(q, _ROOM_M):
                    return q
        return None

    def _reach(self, rng: np.random.Generator, arm: str, T_world_tcp: Array) -> Array | None:
        solver = self._ik[arm]
        for k in range(_IK_STARTS_N):
            start = HOME[GROUPS[f"{arm}_arm"]] if k == 0 else rng.uniform(solver.lower, solver.upper)
            solution = solver.solve(T_world_tcp, start)
            if solution.reached:
                return solution.q
        return None


def random_pose(rng: np.random.Generator, arm: str) -> Array:
    """Return a tcp pose (4, 4) over the table, hand down within a tilt, on either side of the middle."""
    side = 1.0 if arm == "left" else -1.0
    position = np.array([
        rng.uniform(0.30, 0.65),
        side * rng.uniform(-0.15, 0.55),
        rng.uniform(0.08, 0.45),
    ])  # fmt: skip
    yaw, about = rng.uniform(-np.pi, np.pi, 2)
    tilt = rng.uniform(0.0, _TILT_RAD)
    lean = rot_z(about) @ rot_x(tilt) @ rot_z(-about)
    return pose(lean @ rot_z(yaw) @ rot_x(np.pi), position)


def random_obstacles(rng: np.random.Generator, count: int) -> tuple[Shape, ...]:
    """Return boxes and cylinders standing on the table in front of the arms, clear of the bases."""
    shapes: list[Shape] = []
    for k in range(count):
        height = float(rng.uniform(0.10, 0.40))
        while True:
            x, y = float(rng.uniform(0.25, 0.75)), float(rng.uniform(-0.60, 0.60))
            if all(np.hypot(x - bx, y - by) > 0.28 for bx, by, _ in BASE_POSITIONS_M.values()):
                break
        place = (round(x, 4), round(y, 4), round(0.5 * height, 4))
        if rng.random() < 0.5:
            size = (
                round(float(rng.uniform(0.05, 0.16)), 4),
                round(float(rng.uniform(0.05, 0.16)), 4),
                round(height, 4),
            )
            half_yaw = 0.5 * float(rng.uniform(-np.pi / 2, np.pi / 2))
            quat = (float(np.cos(half_yaw)), 0.0, 0.0, float(np.sin(half_yaw)))
            shapes.append(Box(f"box{k}", place, quat, size))
        else:
            radius = round(float(rng.uniform(0.025, 0.07)), 4)
            shapes.append(Cylinder(f"cylinder{k}", place, radius_m=radius, length_m=round(height, 4)))
    return tuple(shapes)
