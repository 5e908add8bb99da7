"""How far can two parts of the scene approach each other while the joints move by a little?

If joint j turns by dq, a point at distance r from its axis moves by at most r |dq|. With r the largest distance
that any point of a part can have from joint j in any posture (the sum of the links between, plus the radius of
the part), the gap between two parts shrinks by at most the sum over the joints that move one against the other.
That turns a set of samples into a proof for everything between them: see `minidual.planning.verify`.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from minidual.planning.coal_engine import CoalEngine
from minidual.planning.scene import PlanningScene
from minidual.robot.constants import DOF, Array


class MotionBound:
    """Upper bounds on relative motion for the checked pairs of one scene.

    Attributes:
        matrix: (14, n) [m/rad], one column a pair in the order of `scene.checked_pairs`.
        column: Column of each pair, names in alphabetical order.
    """

    def __init__(self, scene: PlanningScene, coal_engine: CoalEngine) -> None:
        reach = _reaches(scene, coal_engine)
        self.matrix = np.zeros((DOF, len(scene.checked_pairs)))
        self.column: dict[tuple[str, str], int] = {}
        for index, (a, b) in enumerate(scene.checked_pairs):
            joints_a, joints_b = scene.moving_joints(a), scene.moving_joints(b)
            same_arm = joints_a.start == joints_b.start and joints_a.stop > 0 and joints_b.stop > 0
            column = np.zeros(DOF)
            if same_arm:
                outer, inner = (a, joints_b.stop) if joints_a.stop >= joints_b.stop else (b, joints_a.stop)
                between = slice(inner, max(joints_a.stop, joints_b.stop))
                column[between] = reach[outer][between]
            else:
                column[joints_a] += reach[a][joints_a]
                column[joints_b] += reach[b][joints_b]
            self.matrix[:, index] = column
            first, second = sorted((a, b))
            self.column[first, second] = index

    def largest(self, steps: Array) -> Array:
        """Return for each joint step (n, 14) [rad] the largest approach (n,) [m] of any pair."""
        return (np.abs(steps) @ self.matrix).max(axis=1, initial=0.0)

    def of_pair(self, pair: tuple[str, str], step: Array) -> float:
        """Return the largest approach [m] of one pair (alphabetical) for one step (14,)."""
        return float(np.abs(step) @ self.matrix[:, self.column[pair]])


def _reaches(scene: PlanningScene, coal_engine: CoalEngine) -> dict[str, Array]:
    """Return for every part (14,) [m]: its largest distance from each joint's axis, 0 where that joint moves it not."""
    model = coal_engine.model
    radius: dict[str, float] = {}
    for item in coal_engine.geometry.geometryObjects:
        if item.parentJoint == 0:
            continue
        name = item.name if item.name in scene.names else model.frames[item.parentFrame].name
        radius[name] = max(radius.get(name, 0.0), _radius(item))
    reaches = {name: np.zeros(DOF) for name in scene.names}
    for name, own_radius in radius.items():
        joints = scene.moving_joints(name)
        distance = own_radius
        for j in range(joints.stop - 1, joints.start - 1, -1):
            reaches[name][j] = distance
            # joint j of q is joint j + 1 of the model; its placement is its offset from the joint before
            distance += float(np.linalg.norm(model.jointPlacements[j + 1].translation))
    return reaches


def _radius(item: pin.GeometryObject) -> float:
    """Return the largest distance [m] of a point of the geometry from the joint that carries it."""
    shape = item.geometry
    if hasattr(shape, "points"):
        points = np.array(shape.points())
    else:
        shape.computeLocalAABB()
        low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
        points = np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, -1).T
    placed = points @ item.placement.rotation.T + item.placement.translation
    return float(np.linalg.norm(placed, axis=1).max())
