"""How far does each part of a scene reach from the axes of the joints that move it, in any posture?

If joint j turns by e, a point at distance r from its axis moves by at most r |e|. The reach bounds r: the sum of the
links between, plus the radius of the part round the joint that carries it.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from minidual.collision.coal_engine import CoalEngine
from minidual.collision.scene import PlanningScene
from minidual.robot.constants import DOF, DOF_PER_ARM, Array


class Reaches:
    """Reaches of the m parts that some joint moves.

    Attributes:
        parts: Their names.
        reach: (m, 7) [m], from each joint of its arm; 0 where the joint moves it not.
        first_joint: (m,), first joint of its arm, 0 or 7.
        moves: For each checked pair where the motion of the one and of the other against it stands in a flattened table
            (m + 1, 8), whose row k holds at i the motion of part k seen from what its joint i carries: two links of one
            arm are seen from the inner one, which stands still then (the last row).
    """

    def __init__(self, scene: PlanningScene, engine: CoalEngine) -> None:
        everything = _reaches(scene, engine)
        spans = {name: scene.moving_joints(name) for name in scene.names}
        self.parts = tuple(name for name in scene.names if spans[name].stop > spans[name].start)
        row = {name: k for k, name in enumerate(self.parts)}
        self.first_joint = np.array([spans[name].start for name in self.parts], dtype=np.int64)
        own = self.first_joint[:, None] + np.arange(DOF_PER_ARM)
        self.reach: Array = np.array([everything[name] for name in self.parts])[np.arange(len(row))[:, None], own]
        width = DOF_PER_ARM + 1
        still = len(self.parts) * width
        self.moves: list[tuple[int, int]] = []
        for a, b in scene.checked_pairs:
            n_a, n_b = spans[a].stop - spans[a].start, spans[b].stop - spans[b].start
            if n_a and n_b and spans[a].start == spans[b].start:
                outer, inner_n = (a, n_b) if n_a >= n_b else (b, n_a)
                self.moves.append((row[outer] * width + inner_n, still))
            else:
                self.moves.append((row[a] * width if n_a else still, row[b] * width if n_b else still))


def _reaches(scene: PlanningScene, engine: CoalEngine) -> dict[str, Array]:
    """Return for every part (14,) [m]: its largest distance from each joint's axis, 0 where that joint moves it not."""
    model = engine.model
    radius = {
        name: float(np.max([_radius(engine.geometry.geometryObjects[k]) for k in engine.items[name]]))
        for name in scene.names
        if scene.moving_joints(name).stop > scene.moving_joints(name).start
    }
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
