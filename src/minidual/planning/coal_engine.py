"""The second opinion: coal through Pinocchio, on the convex hulls of the same meshes and the same pairs.

Batches run inside one C++ call with a dynamic bounding-volume tree (about 20 us a state).
"""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from minidual.planning.scene import PlanningScene
from minidual.planning.shapes import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from minidual.robot.constants import FINGER_JOINT_NAMES, FINGER_TRAVEL_M, Array
from minidual.robot.description import dual_panda_urdf

# With coal's default of 1e-6, GJK stops early on about one state in 20 000 and calls a contact of 1 mm free, although
# its own distance query says otherwise; with 1e-9 the two engines agreed on 52 000 of 52 000 states.
_GJK_TOLERANCE = 1e-9


class CoalEngine:
    """Collision checks of one scene."""

    name = "coal"

    def __init__(self, scene: PlanningScene) -> None:
        self.model, self.geometry = _robot_geometry()
        ids: dict[str, list[int]] = {}
        for index, item in enumerate(self.geometry.geometryObjects):
            ids.setdefault(self.model.frames[item.parentFrame].name, []).append(index)
        for shape in scene.solid_obstacles:
            placement = pin.SE3(shape.T_parent_shape)
            ids[shape.name] = [
                self.geometry.addGeometryObject(pin.GeometryObject(shape.name, 0, placement, solid))
                for solid in _solids(shape)
            ]
        for held in scene.attached:
            frame_id = self.model.getFrameId(held.link)
            frame = self.model.frames[frame_id]
            placement = frame.placement * pin.SE3(held.shape.T_parent_shape)
            ids[held.name] = [
                self.geometry.addGeometryObject(
                    pin.GeometryObject(held.name, frame.parentJoint, frame_id, placement, solid)
                )
                for solid in _solids(held.shape)
            ]
        owner: list[int] = []
        for index, (a, b) in enumerate(scene.checked_pairs):
            owner += [index] * (len(ids[a]) * len(ids[b]))
            for first in ids[a]:
                for second in ids[b]:
                    self.geometry.addCollisionPair(pin.CollisionPair(first, second))
        self._pool = pin.TreeBroadPhaseManagerPool_DynamicAABBTreeCollisionManager(
            self.model, self.geometry, 1
        )
        self._requests = list(self._pool.getGeometryData(0).collisionRequests)
        for request in self._requests:
            request.gjk_tolerance = _GJK_TOLERANCE
        self._owner = np.array(owner, dtype=int)
        self._items = [np.flatnonzero(self._owner == k).tolist() for k in range(len(scene.checked_pairs))]
        self._has_margins = False
        self._data = self.model.createData()
        self._placed = pin.GeometryData(self.geometry)
        for request in self._placed.distanceRequests:
            request.gjk_tolerance = _GJK_TOLERANCE

    def collisions(self, Q: Array) -> np.ndarray:
        """Return for each row of Q (n, 14) whether anything touches, (n,) bool."""
        if self._has_margins:
            self._set_margins(np.zeros(len(self._items)))
            self._has_margins = False
        return self._hits(Q)

    def nearer_than(self, Q: Array, margins_m: Array) -> np.ndarray:
        """Return for each row of Q (n, 14) whether any pair is as near as its margin (p,) or nearer, (n,) bool."""
        self._set_margins(margins_m)
        self._has_margins = True
        return self._hits(Q)

    def distances(self, Q: Array) -> Array:
        """Return the distance (n, p) [m] of every checked pair at the rows of Q (n, 14), negative inside.

        Exact and slow (about half a millisecond a state): only for what margins leave open.
        """
        columns = range(len(self._items))
        return np.array([self.pair_distances(q, columns) for q in Q]).reshape(len(Q), len(columns))

    def pair_distances(self, q: Array, pairs: Sequence[int]) -> list[float]:
        """Return the exact distances [m] at q (14,) of the pairs with these columns."""
        pin.updateGeometryPlacements(self.model, self._data, self.geometry, self._placed, q)
        return [
            min(pin.computeDistance(self.geometry, self._placed, item).min_distance for item in self._items[pair])
            for pair in pairs
        ]  # fmt: skip

    def _set_margins(self, margins_m: Array) -> None:
        for request, margin in zip(self._requests, margins_m[self._owner].tolist(), strict=True):
            request.security_margin = margin

    def _hits(self, Q: Array) -> np.ndarray:
        if len(Q) == 0:
            return np.zeros(0, dtype=bool)
        columns = np.asfortranarray(np.asarray(Q, dtype=float).T)
        hits = pin.computeCollisionsInParallel(1, self._pool, columns, True, False)
        return np.array(hits, dtype=bool).ravel()

    def in_collision(self, q: Array) -> bool:
        """Return whether anything touches at q (14,)."""
        return bool(self.collisions(np.asarray(q)[None, :])[0])


def _robot_geometry() -> tuple[pin.Model, pin.GeometryModel]:
    """Return the 14-joint model and its collision geometry, meshes replaced by their convex hulls."""
    urdf = dual_panda_urdf()
    full = pin.buildModelFromXML(urdf)
    full_geometry = pin.buildGeomFromUrdfString(full, urdf, pin.GeometryType.COLLISION)
    reference = pin.neutral(full)
    locked = [full.getJointId(name) for name in FINGER_JOINT_NAMES]
    for joint in locked:
        reference[full.joints[joint].idx_q] = FINGER_TRAVEL_M
    model, geometry = pin.buildReducedModel(full, full_geometry, locked, reference)
    for item in geometry.geometryObjects:
        if isinstance(item.geometry, coal.BVHModelBase):
            item.geometry.buildConvexHull(True, "Qt")
            item.geometry = item.geometry.convex
    return model, geometry


def _solids(shape: Shape) -> list[coal.CollisionGeometry]:
    """Return the convex solids of a shape: several for a mesh, else one."""
    match shape:
        case Box():
            return [coal.Box(*shape.size_m)]
        case Cylinder():
            return [coal.Cylinder(shape.radius_m, shape.length_m)]
        case Capsule():
            return [coal.Capsule(shape.radius_m, shape.length_m)]
        case Sphere():
            return [coal.Sphere(shape.radius_m)]
        case Mesh():
            return [_hull(vertices) for vertices in shape.vertices()]


def _hull(vertices: Array) -> coal.CollisionGeometry:
    """Return the convex hull of (n, 3) points."""
    cloud = coal.BVHModelOBBRSS()
    cloud.beginModel(0, len(vertices))
    cloud.addVertices(np.ascontiguousarray(vertices))
    cloud.endModel()
    cloud.buildConvexHull(True, "Qt")
    return cloud.convex
