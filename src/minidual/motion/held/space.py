"""Points and edges of the search for a held object.

A point z (6 + n,) holds `ObjectChart` coordinates and joints. Edges interpolate both and project
the joints onto the grasps: they depend only on their ends.
"""

from typing import NamedTuple

import numpy as np

from minidual.motion.budget import SOLVE_CHECKS_N
from minidual.motion.held.hands import HandsIK
from minidual.motion.held.path import ObjectChart
from minidual.motion.search import EdgeChecker, bisection_order
from minidual.robot.pair import Array

X = slice(0, 6)
Q = slice(6, None)
JOINT_WEIGHT_M = 0.1
"""Distance per radian of joint motion [m/rad]."""
_STEP_M = 0.03
_STEP_RAD = 0.06
_JUMP_RAD = 0.4
_SURE_RAD = 0.12
_HALVED = 0.75


class _EdgePoint(NamedTuple):
    """Joints (n,) at a share of an edge."""

    share: float
    q: Array


class HeldSpace:
    """Points and edges; `step_scale` scales the check steps."""

    def __init__(
        self,
        hands: HandsIK,
        chart: ObjectChart,
        checker: EdgeChecker,
        step_scale: float = 1.0,
    ) -> None:
        self._step_m = step_scale * _STEP_M
        self._step_rad = step_scale * _STEP_RAD
        self._jump_rad = step_scale * _JUMP_RAD
        self.hands = hands
        self.chart = chart
        self.checker = checker

    def point(self, T_world_object: Array, q: Array) -> Array:
        """Return (6 + n,)."""
        return np.concatenate([self.chart.coordinates(T_world_object), q])

    def solved_free(self, z: Array) -> Array | None:
        """Return z with projected joints, None unless free."""
        self.checker.budget.spend(SOLVE_CHECKS_N)
        q = self.hands.solve(self.chart.pose(z[X]), z[Q])
        if q is None or not self.checker.free(q):
            return None
        return np.concatenate([z[X], q])

    @staticmethod
    def distance(z: Array, Z: Array) -> Array:
        """Return distances (m,) [m] to Z (m, 6 + n)."""
        d = Z - z
        return np.linalg.norm(d[:, X], axis=1) + JOINT_WEIGHT_M * np.linalg.norm(d[:, Q], axis=1)

    def length(self, a: Array, b: Array) -> float:
        """Return the length of an edge [m]."""
        return float(self.distance(a, b[None])[0])

    def edge_free(self, a: Array, b: Array) -> bool:
        """Return whether an edge is continuous, and free between its ends."""
        step = b - a
        object_steps = np.linalg.norm(step[X]) / self._step_m
        joint_steps = np.abs(step[Q]).max() / self._step_rad
        count = max(1, int(np.ceil(max(object_steps, joint_steps))))
        joints = np.empty((count + 1, len(step) - 6))
        joints[0] = a[Q]
        joints[-1] = b[Q]
        for share in bisection_order(count)[1:]:  # the first is b
            z = self.solved_free(a + share * step)
            if z is None:
                return False
            joints[round(share * count)] = z[Q]
        jumps = np.abs(np.diff(joints, axis=0)).max(axis=1)
        if jumps.max() > self._jump_rad:
            return False
        # A large joint step is fast motion (halving the interval halves it) or a change of IK
        # branch.
        for k in np.flatnonzero(jumps > _SURE_RAD):
            before = _EdgePoint(k / count, joints[k])
            after = _EdgePoint((k + 1) / count, joints[k + 1])
            if not self._continuous(a, step, before, after):
                return False
        return True

    def _continuous(
        self,
        a: Array,
        step: Array,
        before: _EdgePoint,
        after: _EdgePoint,
    ) -> bool:
        """Halve a joint step of the edge a + share * step until it is small.

        False if it stays large.
        """
        jump = float(np.abs(after.q - before.q).max())
        if jump <= _SURE_RAD:
            return True
        share = 0.5 * (before.share + after.share)
        z = self.solved_free(a + share * step)
        if z is None:
            return False
        middle = _EdgePoint(share, z[Q])
        halves = max(np.abs(middle.q - before.q).max(), np.abs(after.q - middle.q).max())
        if halves > _HALVED * jump:
            return False
        return self._continuous(a, step, before, middle) and self._continuous(
            a,
            step,
            middle,
            after,
        )

    @staticmethod
    def sample(rng: np.random.Generator, ends: Array, room_m: float, turn_m: float) -> Array:
        """Return random coordinates (6,) around both ends (2, 6)."""
        low = ends[:, :3].min(axis=0) - room_m
        high = ends[:, :3].max(axis=0) + room_m
        low[2] = max(low[2], 0.0)
        between = ends[0, 3:] + rng.uniform() * (ends[1, 3:] - ends[0, 3:])
        position = rng.uniform(low, high)
        turn = between + rng.uniform(-turn_m, turn_m, 3)
        return np.concatenate([position, turn])
