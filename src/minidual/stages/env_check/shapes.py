"""Visual shapes and collision shapes in MuJoCo and Pinocchio, link by link.

A wrong unit, scale or axis of a mesh shows in its bounding box and volume.
"""

from typing import Any, NamedTuple

import coal
import mujoco
import numpy as np
import pinocchio as pin
import trimesh
from scipy.spatial import ConvexHull, QhullError

from minidual.collision.engines import robot_geometry
from minidual.plant.contact import GROUP_COLLISION, GROUP_VISUAL
from minidual.robot.description import drawn_apart, links_of
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot, pose

SIZE_RATIO_MAX = 3.0
"""Of the diagonals of the bounding boxes of visual and collision shapes.

Units are wrong by 10 or more; of the arms of example-robot-data none differs by more than 2.2.
"""
OVERLAP_MIN = 0.5
"""Least share of the smaller bounding box that lies in the other one.

A forearm that is turned by a quarter or by half about its end has 0.26; of the arms of
example-robot-data all links have 0.9 or more, but for Baxter's upper elbow with 0.06 (a row names
such a link in `drawn_apart`).
"""
_MARGIN_M = 0.01
"""Added to each side of a box for this: flat boxes overlap too."""
_SECTIONS = 48
_GEOM = mujoco.mjtGeom


class Extent(NamedTuple):
    """Bounding box and volume of the convex hull of points, in the link's frame.

    Attributes:
        lower_m: Corner (3,).
        upper_m: Opposite corner (3,).
        volume_m3: Of the hull, 0 of what is flat.
    """

    lower_m: Array
    upper_m: Array
    volume_m3: float

    @property
    def diagonal_m(self) -> float:
        """Diagonal of the box."""
        return float(np.linalg.norm(self.upper_m - self.lower_m))

    def record(self) -> dict[str, Any]:
        """Return JSON types."""
        size_m = (self.upper_m - self.lower_m).round(6).tolist()
        return {"size_m": size_m, "volume_m3": round(self.volume_m3, 9)}


class LinkShapes(NamedTuple):
    """Shapes of one link; None: it has none.

    Attributes:
        drawn: What pictures show.
        mujoco: What collides in MuJoCo.
        pinocchio: What collides in Pinocchio.
        may_be_apart: Whether the arm's row says that it is drawn beside what collides.
    """

    drawn: Extent | None
    mujoco: Extent | None
    pinocchio: Extent | None
    may_be_apart: bool = False

    @property
    def extents(self) -> dict[str, Extent | None]:
        """The shapes by what they are for."""
        return {"drawn": self.drawn, "mujoco": self.mujoco, "pinocchio": self.pinocchio}

    @property
    def engines_apart_m(self) -> float:
        """Largest difference of the engines' boxes, or of the edges of cubes of their volumes."""
        if self.mujoco is None or self.pinocchio is None:
            return 0.0 if self.mujoco is self.pinocchio else float("inf")
        lower_m = np.abs(self.mujoco.lower_m - self.pinocchio.lower_m).max()
        upper_m = np.abs(self.mujoco.upper_m - self.pinocchio.upper_m).max()
        edges_m = np.cbrt([self.mujoco.volume_m3, self.pinocchio.volume_m3])
        return float(max(lower_m, upper_m, abs(edges_m[0] - edges_m[1])))

    @property
    def difference(self) -> str:
        """How the visual shape differs too much from the collision shape, or ""."""
        if self.drawn is None or self.mujoco is None:
            return ""
        ratio = self.drawn.diagonal_m / self.mujoco.diagonal_m
        if not 1.0 / SIZE_RATIO_MAX <= ratio <= SIZE_RATIO_MAX:
            return f"is drawn {ratio:.3g} times as large as what collides"
        cubed = SIZE_RATIO_MAX**3
        volumes = self.drawn.volume_m3 / max(self.mujoco.volume_m3, 1e-12)
        if self.drawn.volume_m3 > 0.0 and not 1.0 / cubed <= volumes <= cubed:
            return f"is drawn with {volumes:.3g} times the volume of what collides"
        if not self.may_be_apart and _overlap(self.drawn, self.mujoco) < OVERLAP_MIN:
            off_m = np.linalg.norm(_centre(self.drawn) - _centre(self.mujoco))
            return f"is drawn {off_m:.3g} m beside what collides, or turned against it"
        return ""


def _overlap(one: Extent, other: Extent) -> float:
    """Return the share of the smaller bounding box that lies in the other one."""
    lower_m = np.maximum(one.lower_m, other.lower_m) - _MARGIN_M
    upper_m = np.minimum(one.upper_m, other.upper_m) + _MARGIN_M
    common_m3 = np.prod(np.maximum(upper_m - lower_m, 0.0))
    smaller_m3 = min(
        np.prod(extent.upper_m - extent.lower_m + 2.0 * _MARGIN_M) for extent in (one, other)
    )
    return float(common_m3 / smaller_m3)


def _centre(extent: Extent) -> Array:
    return 0.5 * (extent.lower_m + extent.upper_m)


class ShapeComparison(NamedTuple):
    """All links of both arms.

    Attributes:
        links: Shapes by link.
    """

    links: dict[str, LinkShapes]

    @property
    def engines_max_m(self) -> float:
        """Largest difference between the engines."""
        return max((shapes.engines_apart_m for shapes in self.links.values()), default=0.0)

    @property
    def unlike(self) -> list[str]:
        """Links with different visual and collision shapes, each with the difference."""
        return [f"{link} {s.difference}" for link, s in self.links.items() if s.difference]

    def record(self) -> dict[str, Any]:
        """Return JSON types by link."""
        return {
            link: {
                name: None if extent is None else extent.record()
                for name, extent in shapes.extents.items()
            }
            for link, shapes in self.links.items()
        }


def compare_shapes(model: mujoco.MjModel, robot: Robot) -> ShapeComparison:
    """Compare the shapes of all links.

    Args:
        model: Compiled with visuals.
        robot: Of the model.
    """
    of_pinocchio = _pinocchio_points(robot)
    apart = drawn_apart(robot)
    links: dict[str, LinkShapes] = {}
    for link in links_of(robot):
        body = int(model.body(link).id)
        links[link] = LinkShapes(
            drawn=extent_of(_body_points(model, body, GROUP_VISUAL)),
            mujoco=extent_of(_body_points(model, body, GROUP_COLLISION)),
            pinocchio=extent_of(of_pinocchio.get(link, [])),
            may_be_apart=link in apart,
        )
    return ShapeComparison(links)


def extent_of(points: list[Array]) -> Extent | None:
    """Return the extent of points (n, 3), or None without any."""
    if not points:
        return None
    cloud = np.vstack(points)
    try:
        volume_m3 = float(ConvexHull(cloud).volume)
    except QhullError:  # flat
        volume_m3 = 0.0
    return Extent(cloud.min(axis=0), cloud.max(axis=0), volume_m3)


def _body_points(model: mujoco.MjModel, body: int, group: int) -> list[Array]:
    """Return the corners of a body's geoms of one group, in the body's frame."""
    points: list[Array] = []
    for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
        if int(model.geom_group[geom]) == group:
            R = pin.Quaternion(*model.geom_quat[geom]).matrix()
            points.append(_geom_points(model, geom) @ R.T + model.geom_pos[geom])
    return points


def _geom_points(model: mujoco.MjModel, geom: int) -> Array:
    size = model.geom_size[geom]
    match mujoco.mjtGeom(int(model.geom_type[geom])):
        case _GEOM.mjGEOM_MESH:
            mesh = model.mesh(int(model.geom_dataid[geom]))
            first = int(mesh.vertadr[0])
            return model.mesh_vert[first : first + int(mesh.vertnum[0])].astype(float)
        case _GEOM.mjGEOM_BOX:
            return _box(2.0 * size)
        case _GEOM.mjGEOM_CYLINDER:
            return _cylinder(size[0], 2.0 * size[1])
        case _GEOM.mjGEOM_CAPSULE:
            return _capsule(size[0], 2.0 * size[1])
        case _:
            return _ball(size[0])


def _pinocchio_points(robot: Robot) -> dict[str, list[Array]]:
    """Return the corners of Pinocchio's shapes by link, in the link's frame."""
    model = Kinematics(robot).model
    points: dict[str, list[Array]] = {}
    for item in robot_geometry(robot).geometryObjects:
        frame = model.frames[item.parentFrame]
        T_link_shape = frame.placement.inverse() * item.placement
        T = pose(T_link_shape.rotation, T_link_shape.translation)
        corners = _solid_points(item.geometry) @ T[:3, :3].T + T[:3, 3]
        points.setdefault(frame.name, []).append(corners)
    return points


def _solid_points(shape: coal.CollisionGeometry) -> Array:
    match shape:
        case coal.Sphere():
            return _ball(shape.radius)
        case coal.Capsule():
            return _capsule(shape.radius, 2.0 * shape.halfLength)
        case coal.Cylinder():
            return _cylinder(shape.radius, 2.0 * shape.halfLength)
        case coal.Box():
            return _box(2.0 * np.asarray(shape.halfSide))
        case coal.ConvexBase():
            return np.array(shape.points())
        case _:
            raise TypeError(f"no points of a {type(shape).__name__}")


def _box(size_m: Array) -> Array:
    return np.asarray(trimesh.creation.box(extents=size_m).vertices)


def _cylinder(radius_m: float, length_m: float) -> Array:
    return np.asarray(
        trimesh.creation.cylinder(radius_m, length_m, sections=_SECTIONS).vertices,
    )


def _capsule(radius_m: float, length_m: float) -> Array:
    capsule = trimesh.creation.capsule(length_m, radius_m, count=[_SECTIONS, _SECTIONS])
    return np.asarray(capsule.vertices)


def _ball(radius_m: float) -> Array:
    return np.asarray(trimesh.creation.icosphere(subdivisions=3, radius=radius_m).vertices)
