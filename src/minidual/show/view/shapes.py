"""Visible geoms as coloured triangle meshes."""

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt
import trimesh

from minidual.robot.pair import pose, rotation_from_quat

HIDDEN_GROUP = 3
"""Collision geoms from here on, also hidden by MuJoCo's viewer."""
_SHARP_RAD = np.deg2rad(35.0)
"""Sharper edges stay unsmoothed."""


@dataclass(frozen=True)
class BodyMesh:
    """Triangles of one colour in body frame [m]; body 0 is the world."""

    body: int
    vertices: npt.NDArray[np.float32]
    faces: npt.NDArray[np.int32]
    rgba: tuple[float, float, float, float]


def moving_bodies(model: mujoco.MjModel) -> list[int]:
    """Return the bodies not welded to the world."""
    return [body for body in range(1, model.nbody) if int(model.body_weldid[body]) != 0]


def body_meshes(model: mujoco.MjModel) -> list[BodyMesh]:
    """Return visible meshes, merged by body and colour for speed."""
    parts: dict[tuple[int, tuple[float, ...]], list[trimesh.Trimesh]] = {}
    for geom in range(model.ngeom):
        if int(model.geom_group[geom]) >= HIDDEN_GROUP or float(model.geom_rgba[geom, 3]) == 0.0:
            continue
        mesh = _mesh(model, geom)
        if mesh is None:
            continue
        mesh.apply_transform(pose(rotation_from_quat(model.geom_quat[geom]), model.geom_pos[geom]))
        rgba = tuple(round(float(c), 4) for c in model.geom_rgba[geom])
        parts.setdefault((int(model.geom_bodyid[geom]), rgba), []).append(mesh)
    result = []
    for (body, rgba), meshes in parts.items():
        whole = trimesh.graph.smooth_shade(trimesh.util.concatenate(meshes), angle=_SHARP_RAD)
        vertices, faces = whole.vertices.astype(np.float32), whole.faces.astype(np.int32)
        result.append(BodyMesh(body, vertices, faces, rgba))  # type: ignore[arg-type]
    return result


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    size, kind = model.geom_size[geom], mujoco.mjtGeom(int(model.geom_type[geom]))
    match kind:
        case mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.mesh(int(model.geom_dataid[geom]))
            vertices = model.mesh_vert[int(mesh.vertadr[0]) :][: int(mesh.vertnum[0])]
            faces = model.mesh_face[int(mesh.faceadr[0]) :][: int(mesh.facenum[0])]
            return trimesh.Trimesh(vertices.astype(float), faces.astype(int), process=False)
        case mujoco.mjtGeom.mjGEOM_BOX:
            return trimesh.creation.box(extents=2.0 * size)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return trimesh.creation.cylinder(radius=size[0], height=2.0 * size[1], sections=40)
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            return trimesh.creation.capsule(radius=size[0], height=2.0 * size[1], count=[24, 24])
        case mujoco.mjtGeom.mjGEOM_SPHERE | mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            ball = trimesh.creation.icosphere(subdivisions=3)
            return ball.apply_scale(size[0] if kind == mujoco.mjtGeom.mjGEOM_SPHERE else size)
    return None


def floor_height(model: mujoco.MjModel) -> float | None:
    """Return the first plane's height [m]."""
    planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    return float(model.geom_pos[planes[0], 2]) if len(planes) else None
