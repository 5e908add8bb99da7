"""The space in which a held object moves: its pose leads, both hands follow by inverse kinematics.

A point is z (20,): six coordinates of the object's pose (`ObjectChart`) and the 14 joints that hold it there. The
straight line between two points is a line of object poses and of joints; at each of its poses the joints are projected
onto the grasps (`HandsIK.solve`). So an edge is a function of its two ends alone: whoever looks at it, and however
finely, sees the same motion.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from minidual.motion.edges import EdgeChecker, bisection_order
from minidual.motion.hands_ik import HandsIK
from minidual.motion.object_path import ObjectChart
from minidual.robot.constants import Array

X, Q = slice(0, 6), slice(6, 20)
JOINT_WEIGHT_M = 0.1
"""How much of a distance one radian of all joints together counts for [m/rad]."""
_STEP_M = 0.03
_STEP_RAD = 0.06
_JUMP_RAD = 0.4
_SURE_RAD = 0.12
_HALVED = 0.75


class HeldSpace:
    """Points, distances and edges of one held object in one scene.

    Args:
        hands: Follows the object.
        chart: Coordinates of object poses.
        checker: Collision checks of configurations (14,).
        step_scale: How much closer than usual (1.0) the points of an edge are checked.
    """

    def __init__(self, hands: HandsIK, chart: ObjectChart, checker: EdgeChecker, step_scale: float = 1.0) -> None:
        self._step_m, self._step_rad = step_scale * _STEP_M, step_scale * _STEP_RAD
        self._jump_rad = step_scale * _JUMP_RAD
        self.hands = hands
        self.chart = chart
        self.checker = checker

    def point(self, T_world_object: Array, q: Array) -> Array:
        """Return the point (20,) of an object pose and the joints that hold it there."""
        return np.concatenate([self.chart.coordinates(T_world_object), q])

    def solved(self, z: Array) -> Array | None:
        """Return z with its joints projected onto the grasps, or None."""
        q = self.hands.solve(self.chart.pose(z[X]), z[Q])
        return None if q is None else np.concatenate([z[X], q])

    def solved_free(self, z: Array) -> Array | None:
        """Return z with its joints projected onto the grasps if that is free of collision, or None."""
        z_solved = self.solved(z)
        return z_solved if z_solved is not None and self.checker.free(z_solved[Q]) else None

    @staticmethod
    def distance(z: Array, Z: Array) -> Array:
        """Return the distance [m] of z (20,) to points Z (n, 20)."""
        d = Z - z
        return np.linalg.norm(d[:, X], axis=1) + JOINT_WEIGHT_M * np.linalg.norm(d[:, Q], axis=1)

    def edge_free(self, a: Array, b: Array) -> bool:
        """Return whether the edge from a to b, both (20,) and free, can be followed and is free."""
        step = b - a
        count = int(np.ceil(max(np.linalg.norm(step[X]) / self._step_m, np.abs(step[Q]).max() / self._step_rad)))
        count = max(count, 1)
        joints = np.empty((count + 1, 14))
        joints[0], joints[-1] = a[Q], b[Q]
        for share in bisection_order(count):
            if share == 1.0:
                continue
            z = self.solved_free(a + share * step)
            if z is None:
                return False
            joints[round(share * count)] = z[Q]
        jumps = np.abs(np.diff(joints, axis=0)).max(axis=1)
        if jumps.max() > self._jump_rad:
            return False
        # A large joint step is either a fast motion or a change of branch: half-way it is half as large, or it is not.
        return all(
            self._continuous(a, step, k / count, (k + 1) / count, joints[k], joints[k + 1])
            for k in np.flatnonzero(jumps > _SURE_RAD)
        )

    def _continuous(self, a: Array, step: Array, u: float, v: float, q_u: Array, q_v: Array) -> bool:
        """Return whether the joints move on without a break between two shares u, v of an edge."""
        jump = float(np.abs(q_v - q_u).max())
        if jump <= _SURE_RAD:
            return True
        middle = 0.5 * (u + v)
        z = self.solved_free(a + middle * step)
        if z is None or max(np.abs(z[Q] - q_u).max(), np.abs(q_v - z[Q]).max()) > _HALVED * jump:
            return False
        return self._continuous(a, step, u, middle, q_u, z[Q]) and self._continuous(a, step, middle, v, z[Q], q_v)

    def samples(self, rng: np.random.Generator, ends: Array, room_m: float, turn_m: float) -> Iterator[Array]:
        """Yield random coordinates (6,): in the box round the ends, `room_m` wider, turns up to `turn_m` about them.

        Args:
            rng: Source.
            ends: Coordinates of start and goal (2, 6).
            room_m: How much wider the box of positions is on every side.
            turn_m: Largest weighted rotation vector component beside the way from start to goal [m].
        """
        low, high = ends[:, :3].min(axis=0) - room_m, ends[:, :3].max(axis=0) + room_m
        low[2] = max(low[2], 0.0)
        while True:
            between = ends[0, 3:] + rng.uniform() * (ends[1, 3:] - ends[0, 3:])
            yield np.concatenate([rng.uniform(low, high), between + rng.uniform(-turn_m, turn_m, 3)])
