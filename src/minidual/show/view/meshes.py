"""Meshes of a MuJoCo model, as the browser draws them."""

from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt
import pinocchio as pin
import trimesh

from minidual.plant.marks import goal_mark
from minidual.robot.pair import Array, pose

HIDDEN_GROUP = 3
"""Collision geoms from here on, also hidden by MuJoCo's viewer."""
_SHARP_RAD = np.deg2rad(35.0)
"""Sharper edges stay unsmoothed."""
_GEOM = mujoco.mjtGeom
_FLAT_M = 0.002
"""Thinner meshes cast no shadow, which would blur table marks."""


class BodyMesh(NamedTuple):
    """Triangles of one colour in body frame [m]; body 0 is the world."""

    body: int
    vertices: npt.NDArray[np.float32]
    faces: npt.NDArray[np.int32]
    rgba: tuple[float, float, float, float]

    @property
    def is_flat(self) -> bool:
        """Whether it is too thin to cast a shadow."""
        return float(np.ptp(self.vertices, axis=0).min()) < _FLAT_M


def moving_bodies(model: mujoco.MjModel) -> list[int]:
    """Return the bodies not welded to the world."""
    return [body for body in range(1, model.nbody) if int(model.body_weldid[body]) != 0]


def body_meshes(model: mujoco.MjModel) -> list[BodyMesh]:
    """Return visible meshes, merged by body and colour for speed; the goal's mark is apart."""
    moved = goal_mark(model)
    parts: dict[tuple[int, tuple[float, ...]], list[trimesh.Trimesh]] = {}
    for geom in range(model.ngeom):
        if geom == moved or _is_hidden(model, geom):
            continue
        mesh = _mesh(model, geom)
        if mesh is None:
            continue
        R_body_geom = pin.Quaternion(*model.geom_quat[geom]).matrix()
        mesh.apply_transform(pose(R_body_geom, model.geom_pos[geom]))
        body = int(model.geom_bodyid[geom])
        parts.setdefault((body, _rgba(model, geom)), []).append(mesh)
    return [_merged(body, rgba, meshes) for (body, rgba), meshes in parts.items()]


def goal_mesh(model: mujoco.MjModel) -> BodyMesh | None:
    """Return the mesh of the goal's mark in its own frame; None if there is no such mark."""
    geom = goal_mark(model)
    if geom is None:
        return None
    mesh = _mesh(model, geom)
    return None if mesh is None else _merged(0, _rgba(model, geom), [mesh])


def _rgba(model: mujoco.MjModel, geom: int) -> tuple[float, ...]:
    return tuple(round(float(channel), 4) for channel in model.geom_rgba[geom])


def _is_hidden(model: mujoco.MjModel, geom: int) -> bool:
    is_collision = int(model.geom_group[geom]) >= HIDDEN_GROUP
    is_transparent = float(model.geom_rgba[geom, 3]) == 0.0
    return is_collision or is_transparent


def _merged(body: int, rgba: tuple[float, ...], meshes: list[trimesh.Trimesh]) -> BodyMesh:
    whole = trimesh.graph.smooth_shade(trimesh.util.concatenate(meshes), angle=_SHARP_RAD)
    vertices = whole.vertices.astype(np.float32)
    faces = whole.faces.astype(np.int32)
    return BodyMesh(body, vertices, faces, rgba)  # type: ignore[arg-type]


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """Return the mesh of a geom in its own frame; None for a shape without one, such as a plane."""
    size: Array = model.geom_size[geom]
    match mujoco.mjtGeom(int(model.geom_type[geom])):
        case _GEOM.mjGEOM_MESH:
            return _stored_mesh(model, int(model.geom_dataid[geom]))
        case _GEOM.mjGEOM_BOX:
            return trimesh.creation.box(extents=2.0 * size)
        case _GEOM.mjGEOM_CYLINDER:
            return trimesh.creation.cylinder(size[0], 2.0 * size[1], sections=40)
        case _GEOM.mjGEOM_CAPSULE:
            return trimesh.creation.capsule(2.0 * size[1], size[0], count=[24, 24])
        case _GEOM.mjGEOM_SPHERE:
            return trimesh.creation.icosphere(subdivisions=3).apply_scale(size[0])
        case _:
            return None


def _stored_mesh(model: mujoco.MjModel, index: int) -> trimesh.Trimesh:
    mesh = model.mesh(index)
    first_vertex = int(mesh.vertadr[0])
    first_face = int(mesh.faceadr[0])
    vertices = model.mesh_vert[first_vertex : first_vertex + int(mesh.vertnum[0])]
    faces = model.mesh_face[first_face : first_face + int(mesh.facenum[0])]
    return trimesh.Trimesh(vertices.astype(float), faces.astype(int), process=False)
