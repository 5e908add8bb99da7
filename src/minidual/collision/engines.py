"""Collision checks on convex hulls.

By coal through Pinocchio (about 20 us a state), and by MuJoCo (about 15 us).
"""

import functools
import itertools
from typing import Any, NamedTuple

import coal
import mujoco
import numpy as np
import pinocchio as pin

from minidual.collision.shapes import Box, Capsule, Cylinder, Mesh, PairDistance, Shape, Sphere
from minidual.robot.description import collision_links, mujoco_urdf, pair_urdf
from minidual.robot.kinematics import Kinematics, full_model, link_frame
from minidual.robot.pair import Array, Robot

# With coal's default of 1e-6, GJK stops early in about one state of 20 000 and misses a contact of
# 1 mm. With 1e-9 the two engines agreed on 52 000 of 52 000 states.
_GJK_TOLERANCE = 1e-9
BOX_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_SOLIDS = {Box: coal.Box, Cylinder: coal.Cylinder, Capsule: coal.Capsule, Sphere: coal.Sphere}


class CoalEngine:
    """Checks a scene or `Pairs`; `items`: geometry objects by part."""

    def __init__(self, scene: Any) -> None:
        self.model = Kinematics(scene.robot).model
        self.geometry = robot_geometry(scene.robot).copy()
        self.items: dict[str, list[int]] = {}
        for index, item in enumerate(self.geometry.geometryObjects):
            self.items.setdefault(self.model.frames[item.parentFrame].name, []).append(index)
        for solid in scene.solids:
            self.items[solid.name] = self._add(solid.name, solid.link, solid.shape)
        for a, b in scene.checked_pairs:
            for item_a, item_b in itertools.product(self.items[a], self.items[b]):
                self.geometry.addCollisionPair(pin.CollisionPair(item_a, item_b))
        self._pool = pin.TreeBroadPhaseManagerPool_DynamicAABBTreeCollisionManager(
            self.model,
            self.geometry,
            1,
        )
        for request in self._pool.getGeometryData(0).collisionRequests:
            request.gjk_tolerance = _GJK_TOLERANCE

    def _add(self, name: str, link: str, shape: Shape) -> list[int]:
        """Add a shape to a link; return its geometry objects."""
        frame_id = link_frame(self.model, link)
        frame = self.model.frames[frame_id]
        place = frame.placement * pin.SE3(shape.T_parent_shape)
        items: list[int] = []
        for piece in convex_solids(shape):
            item = pin.GeometryObject(name, frame.parentJoint, frame_id, place, piece)
            items.append(self.geometry.addGeometryObject(item))
        return items

    def collisions(self, Q: Array) -> np.ndarray:
        """See `ENGINES`."""
        if len(Q) == 0:
            return np.zeros(0, dtype=bool)
        columns = np.asfortranarray(np.asarray(Q, dtype=float).T)
        contacts = pin.computeCollisionsInParallel(1, self._pool, columns, True, False)
        return np.array(contacts, dtype=bool).ravel()


@functools.cache
def robot_geometry(robot: Robot) -> pin.GeometryModel:
    """Return the robot's convex hulls. Cached: do not modify."""
    full, fingers, q = full_model(robot)
    full_geometry = pin.buildGeomFromUrdfString(full, pair_urdf(robot), pin.GeometryType.COLLISION)
    _, geometry = pin.buildReducedModel(full, full_geometry, fingers, q)
    for item in geometry.geometryObjects:
        if isinstance(item.geometry, coal.BVHModelBase):
            item.geometry.buildConvexHull(True, "Qt")
            item.geometry = item.geometry.convex
    return geometry


def convex_solids(shape: Shape) -> list[coal.CollisionGeometry]:
    """Return one solid, or one per mesh piece."""
    if isinstance(shape, Mesh):
        return [
            coal.ConvexBase.convexHull([*vertices], True, "Qt") for vertices in shape.vertices()
        ]
    return [_SOLIDS[type(shape)](*shape.lengths())]


_CLOSEST_WITHIN_M = 0.1
_KIND = mujoco.mjtGeom
_ROUND = {
    Cylinder: _KIND.mjGEOM_CYLINDER,
    Capsule: _KIND.mjGEOM_CAPSULE,
    Sphere: _KIND.mjGEOM_SPHERE,
}


class BoundedPair(NamedTuple):
    """The pair nearest to its bound.

    Attributes:
        pair: "a with b", or "none".
        distance_m: Its distance [m].
        bound_m: Its bound [m].
    """

    pair: str
    distance_m: float
    bound_m: float


class MujocoEngine:
    """Checks a scene or `Pairs`. One instance per process."""

    def __init__(self, scene: Any) -> None:
        robot = scene.robot
        self.model = _compiled(scene)
        self.data = mujoco.MjData(self.model)
        for joint in robot.finger_joint_names:
            self.data.qpos[self.model.joint(joint).qposadr[0]] = robot.hand.travel_m
        self._addresses = np.array(
            [int(self.model.joint(name).qposadr[0]) for name in robot.joint_names],
        )
        self.body_names = [self.model.body(i).name for i in range(self.model.nbody)]
        self._margin_m = 0.0

    def contact_count(self, q: Array, margin_m: float = 0.0) -> int:
        """Count contacts at q (n,), and pairs nearer than `margin_m`."""
        if margin_m != self._margin_m:
            self.model.geom_margin[:] = 0.5 * margin_m  # MuJoCo adds the margins of the two geoms
            self.model.body_margin[:] = 0.5 * margin_m
            self._margin_m = margin_m
        self.data.qpos[self._addresses] = q
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        return self.data.ncon

    def place(self, name: str, T_parent_shape: Array) -> None:
        """Move an obstacle, or what is attached, to a pose (4, 4) in its parent."""
        body = self.model.body(name).id
        self.model.body_pos[body] = T_parent_shape[:3, 3]
        mujoco.mju_mat2Quat(self.model.body_quat[body], T_parent_shape[:3, :3].ravel())

    def collisions(self, Q: Array) -> np.ndarray:
        """See `ENGINES`."""
        return np.fromiter((self.contact_count(q) > 0 for q in Q), dtype=bool, count=len(Q))

    def closest(self, q: Array, within_m: float = _CLOSEST_WITHIN_M) -> list[PairDistance]:
        """Return pairs nearer than `within_m` at q (n,), nearest first."""
        count = self.contact_count(q, within_m)
        bodies = self.model.geom_bodyid[self.data.contact.geom[:count]]
        nearest: dict[tuple[str, str], float] = {}
        for pair, distance in zip(bodies, self.data.contact.dist[:count], strict=True):
            first, second = sorted(self.body_names[body] for body in pair)
            before = nearest.get((first, second), np.inf)
            nearest[first, second] = min(float(distance), before)
        pairs = [PairDistance(*names, distance) for names, distance in nearest.items()]
        return sorted(pairs, key=lambda pair: (pair.distance_m, pair.first, pair.second))

    def nearest(self, q: Array, within_m: float, least_m: Array) -> BoundedPair:
        """Return the pair nearest to its bound at q (n,); "none" beyond `within_m`.

        `least_m` holds the bounds by body (nbody, nbody) [m].
        """
        count = self.contact_count(q, within_m)
        if count == 0:
            return BoundedPair("none", within_m, 0.0)
        contact = self.data.contact
        bodies = self.model.geom_bodyid[contact.geom[:count]]
        distances = contact.dist[:count]
        bounds = least_m[bodies[:, 0], bodies[:, 1]]
        k = int((distances - bounds).argmin())
        pair = " with ".join(sorted(self.body_names[body] for body in bodies[k]))
        return BoundedPair(pair, float(distances[k]), float(bounds[k]))

    def touching_pairs(self, q: Array) -> set[frozenset[str]]:
        """Return touching pairs at q (n,)."""
        return {frozenset((c.first, c.second)) for c in self.closest(q, 0.0)}


def _compiled(scene: Any) -> mujoco.MjModel:
    """Return MuJoCo's model of a scene, in which only its checked pairs collide."""
    robot = scene.robot
    spec = mujoco.MjSpec.from_string(mujoco_urdf(robot))
    for solid in scene.solids:
        add_body(spec, spec.body(solid.link), solid.shape)
    _boxes_to_meshes(spec)
    checked = {frozenset(pair) for pair in scene.checked_pairs}
    names = (*collision_links(robot), *(solid.name for solid in scene.solids))
    for a, b in itertools.combinations(names, 2):
        if frozenset((a, b)) not in checked:
            spec.add_exclude(bodyname1=a, bodyname2=b)
    model = spec.compile()
    # The scene decides about pairs; MuJoCo's own parent-child filter would hide some.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    return model


def _boxes_to_meshes(spec: mujoco.MjSpec) -> None:
    """Replace boxes by meshes: MuJoCo's box-box test gives most separate pairs no distance."""
    for index, geom in enumerate(spec.geoms):
        if geom.type == _KIND.mjGEOM_BOX:
            corners = (BOX_CORNERS * geom.size).ravel()
            geom.meshname = spec.add_mesh(name=f"box_mesh{index}", uservert=corners).name
            geom.type = _KIND.mjGEOM_MESH
            geom.size = np.zeros(3)


def add_body(
    spec: mujoco.MjSpec,
    parent: mujoco.MjsBody,
    shape: Shape,
    prefix: str = "",
    **attributes: Any,
) -> None:
    """Add a shape to a body; `attributes` are further ones of its geoms."""
    name = prefix + shape.name
    body = parent.add_body(name=name, pos=list(shape.position_m), quat=list(shape.quat_wxyz))
    if isinstance(shape, Mesh):
        for index, vertices in enumerate(shape.vertices()):
            mesh = spec.add_mesh(name=f"{name}:{index}", uservert=vertices.ravel())
            body.add_geom(type=_KIND.mjGEOM_MESH, meshname=mesh.name, **attributes)
    elif isinstance(shape, Box):
        body.add_geom(type=_KIND.mjGEOM_BOX, size=[0.5 * v for v in shape.size_m], **attributes)
    else:
        radius_m, *lengths_m = shape.lengths()
        half_length_m = 0.5 * sum(lengths_m)  # a sphere has none
        size = [radius_m, half_length_m, 0.0]
        body.add_geom(type=_ROUND[type(shape)], size=size, **attributes)
