"""How far can two parts of the scene approach each other while the joints move by a little?

If joint j turns by dq, a point at distance r from its axis moves by at most r |dq|. So the gap between two parts
shrinks by at most the sum of r |dq| over the joints that move one against the other. Two values of r are known:

* the reach: the largest distance from the axis in any posture (the sum of the links between, plus the radius of
  the part); it holds everywhere and is two or three times too large in most postures;
* the lever: the distance in a measured posture (`minidual.planning.levers`). While a joint further out moves, the
  lever of a joint further in changes by no more than that part moves against it, which its reach bounds.

Either way a set of samples becomes a proof for everything between them: see `minidual.planning.certificate`.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from minidual.planning.coal_engine import CoalEngine
from minidual.planning.scene import PlanningScene
from minidual.robot.constants import DOF, DOF_PER_ARM, Array


class MotionBound:
    """Upper bounds on relative motion for the checked pairs of one scene.

    Attributes:
        matrix: (14, p) [m/rad], one column a pair in the order of `scene.checked_pairs`, from the reaches.
        column: Column of each pair, names in alphabetical order.
        parts: The m parts that some joint moves, in the order of the rows of levers.
        joints_n: (m,) how many joints of its arm move each of them.
        reach: (m, 7) [m], reach of each part from each joint of its arm; 0 where the joint moves it not.
    """

    def __init__(self, scene: PlanningScene, coal_engine: CoalEngine) -> None:
        everything = _reaches(scene, coal_engine)
        spans = {name: scene.moving_joints(name) for name in scene.names}
        self.parts = tuple(name for name in scene.names if spans[name].stop > 0)
        row = {name: k for k, name in enumerate(self.parts)}
        self._first_joint = np.array([spans[name].start for name in self.parts])
        self.joints_n = np.array([spans[name].stop - spans[name].start for name in self.parts])
        own = self._first_joint[:, None] + np.arange(DOF_PER_ARM)
        self.reach = np.array([everything[name] for name in self.parts])[np.arange(len(row))[:, None], own]
        self.column: dict[tuple[str, str], int] = {}
        nothing = (len(self.parts), 0)
        terms: list[tuple[tuple[int, int], tuple[int, int]]] = []
        for index, (a, b) in enumerate(scene.checked_pairs):
            n_a, n_b = spans[a].stop - spans[a].start, spans[b].stop - spans[b].start
            if n_a and n_b and spans[a].start == spans[b].start:
                outer, inner_n = (a, n_b) if n_a >= n_b else (b, n_a)
                terms.append(((row[outer], inner_n), nothing))
            else:
                terms.append(((row[a], 0) if n_a else nothing, (row[b], 0) if n_b else nothing))
            first, second = sorted((a, b))
            self.column[first, second] = index
        # A motion of part k against what its joint i carries stands at k * 8 + i of a flattened table.
        width = DOF_PER_ARM + 1
        self._one = np.array([k * width + i for (k, i), _ in terms], dtype=int)
        self._other = np.array([k * width + i for _, (k, i) in terms], dtype=int)
        self.matrix = self.approach(np.eye(DOF))

    def largest(self, steps: Array) -> Array:
        """Return for each joint step (n, 14) [rad] the largest approach (n,) [m] of any pair, from the reaches."""
        return (np.abs(steps) @ self.matrix).max(axis=1, initial=0.0)

    def of_pair(self, pair: tuple[str, str], step: Array) -> float:
        """Return the largest approach [m] of one pair (alphabetical) for one step (14,), from the reaches."""
        return float(np.abs(step) @ self.matrix[:, self.column[pair]])

    def approach(
        self, variation: Array, levers_a: Array | None = None, levers_b: Array | None = None
    ) -> Array:
        """Return the largest approach (n, p) [m] of every pair over n stretches of motion.

        Args:
            variation: (n, 14) [rad], how far each joint travels in all over each stretch (not start to end).
            levers_a: (n, m, 7) [m] at the start of each stretch; without them the reaches count.
            levers_b: (n, m, 7) [m] at its end.
        """
        travel = variation[:, self._first_joint[:, None] + np.arange(DOF_PER_ARM)]  # (n, m, 7)
        arms = np.broadcast_to(self.reach, travel.shape)
        if levers_a is not None and levers_b is not None:
            # A lever changes by at most what the part moves against that joint, and it must suit both ends.
            drift = np.zeros_like(travel)
            drift[:, :, :-1] = np.cumsum((self.reach * travel)[:, :, :0:-1], axis=2)[:, :, ::-1]
            arms = np.minimum(arms, 0.5 * (levers_a + levers_b + drift))
        moved = np.zeros((len(variation), len(self.parts) + 1, DOF_PER_ARM + 1))
        moved[:, :-1, :-1] = np.cumsum((arms * travel)[:, :, ::-1], axis=2)[:, :, ::-1]
        flat = moved.reshape(len(variation), -1)
        return flat[:, self._one] + flat[:, self._other]


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
