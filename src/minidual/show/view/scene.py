"""Browser scene: built once, then updated."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt
import pinocchio as pin
import trimesh

from minidual.robot.pair import pose
from minidual.show.view.overlay import NO_PREVIEW, Array, Arrow, Preview

HIDDEN_GROUP = 3
"""Collision geoms from here on, also hidden by MuJoCo's viewer."""
_SHARP_RAD = np.deg2rad(35.0)
"""Sharper edges stay unsmoothed."""
_ARROW_M_PER_N = 0.0025  # 10 cm at 40 N
_ARROW_MIN_N = 0.5
_MOVED = 1e-5
"""Least change [m, quaternion] that is sent."""
_FLAT_M = 0.002  # thinner meshes cast no shadow, which would blur table marks
_GHOSTS_MAX = 4
_GHOST_MOVED = 1e-3
_GHOST_RGB = (70, 160, 255)
_FLOOR_RGB = (214, 220, 228)
_FOG_RGB = (255, 255, 255)
_CAMERA = (1.85, -0.85, 0.95)
_TARGET = (0.30, 0.10, 0.17)
_FOV_RAD = 0.70
_KIND = mujoco.mjtGeom
_SOLIDS: dict[mujoco.mjtGeom, Callable[[Array], trimesh.Trimesh]] = {
    _KIND.mjGEOM_BOX: lambda size: trimesh.creation.box(extents=2.0 * size),
    _KIND.mjGEOM_CYLINDER: lambda size: trimesh.creation.cylinder(
        size[0],
        2.0 * size[1],
        sections=40,
    ),
    _KIND.mjGEOM_CAPSULE: lambda size: trimesh.creation.capsule(
        2.0 * size[1],
        size[0],
        count=[24, 24],
    ),
    _KIND.mjGEOM_SPHERE: lambda size: trimesh.creation.icosphere(subdivisions=3).apply_scale(
        size[0],
    ),
}
_FLOOR_HALF_M = 30.0  # hides the floor's edge in fog


class BodyMesh(NamedTuple):
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
        hidden = (
            int(model.geom_group[geom]) >= HIDDEN_GROUP or float(model.geom_rgba[geom, 3]) == 0.0
        )
        if hidden or (mesh := _mesh(model, geom)) is None:
            continue
        mesh.apply_transform(
            pose(pin.Quaternion(*model.geom_quat[geom]).matrix(), model.geom_pos[geom]),
        )
        rgba = tuple(round(float(c), 4) for c in model.geom_rgba[geom])
        parts.setdefault((int(model.geom_bodyid[geom]), rgba), []).append(mesh)
    result = []
    for (body, rgba), meshes in parts.items():
        whole = trimesh.graph.smooth_shade(trimesh.util.concatenate(meshes), angle=_SHARP_RAD)
        vertices = whole.vertices.astype(np.float32)
        faces = whole.faces.astype(np.int32)
        result.append(BodyMesh(body, vertices, faces, rgba))  # type: ignore[arg-type]
    return result


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    size = model.geom_size[geom]
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    if kind == _KIND.mjGEOM_MESH:
        mesh = model.mesh(int(model.geom_dataid[geom]))
        vertices = model.mesh_vert[int(mesh.vertadr[0]) :][: int(mesh.vertnum[0])]
        faces = model.mesh_face[int(mesh.faceadr[0]) :][: int(mesh.facenum[0])]
        return trimesh.Trimesh(vertices.astype(float), faces.astype(int), process=False)
    return _SOLIDS[kind](size) if kind in _SOLIDS else None


class Scene:
    """Scene of a model with visual meshes; resets the server's scene."""

    def __init__(self, server: Any, model: mujoco.MjModel) -> None:
        self._server = server
        self._model = model
        self._meshes = body_meshes(model)
        self._arrows: Any = None
        self._preview: Preview = NO_PREVIEW
        self._preview_nodes: list[Any] = []
        scene = server.scene
        scene.reset()
        self._light()
        planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
        if len(planes):
            corners = _FLOOR_HALF_M * np.array(
                [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]],
                dtype=np.float32,
            )
            faces = np.array([[0, 1, 2], [0, 2, 3]])
            position = (0.0, 0.0, float(model.geom_pos[planes[0], 2]))
            scene.add_mesh_simple(
                "/floor",
                corners,
                faces,
                color=_FLOOR_RGB,
                position=position,
                cast_shadow=False,
            )
        drawn = {mesh.body for mesh in self._meshes}
        rest = mujoco.MjData(model)
        mujoco.mj_kinematics(model, rest)
        self._frames = self._add_bodies("/scene", rest, drawn)
        self._moving = [body for body in moving_bodies(model) if body in drawn]
        self._sent: dict[int, Array] = {body: np.full(7, np.inf) for body in self._moving}

    def _light(self) -> None:
        scene = self._server.scene
        camera = self._server.initial_camera
        scene.set_up_direction("+z")
        scene.configure_environment_map("studio", background=False, environment_intensity=0.22)
        scene.configure_default_lights(enabled=False)
        scene.add_light_hemisphere("/light/sky", ground_color=(120, 126, 138), intensity=0.42)
        scene.add_light_directional(
            "/light/key",
            color=(255, 250, 240),
            intensity=1.15,
            cast_shadow=True,
            position=(1.2, 1.0, 2.6),
        )
        scene.configure_fog(4.0, 14.0, color=_FOG_RGB)
        camera.position = _CAMERA
        camera.look_at = _TARGET
        camera.up = (0.0, 0.0, 1.0)
        camera.fov = _FOV_RAD
        camera.near = 0.05
        camera.far = 60.0

    def _add_bodies(
        self,
        root: str,
        data: mujoco.MjData,
        bodies: set[int],
        *,
        ghost: bool = False,
    ) -> dict[int, Any]:
        frames: dict[int, Any] = {}
        names = {
            body: f"{root}/{body}_{self._model.body(body).name.replace('/', '_')}"
            for body in sorted(bodies)
        }
        for body, name in names.items():
            pose = {"position": data.xpos[body].copy(), "wxyz": data.xquat[body].copy()}
            frames[body] = self._server.scene.add_frame(name, show_axes=False, **pose)
        for index, mesh in enumerate(self._meshes):
            if mesh.body in bodies:
                flat = float(np.ptp(mesh.vertices, axis=0).min()) < _FLAT_M
                self._server.scene.add_mesh_simple(
                    f"{names[mesh.body]}/mesh{index}",
                    mesh.vertices,
                    mesh.faces,
                    color=_GHOST_RGB if ghost else tuple(round(255 * c) for c in mesh.rgba[:3]),
                    opacity=0.28 if ghost else (mesh.rgba[3] if mesh.rgba[3] < 1.0 else None),
                    cast_shadow=not (ghost or flat),
                    receive_shadow=not ghost,
                )
        return frames

    def move(self, positions: Array, quaternions: Array) -> int:
        """Send changed poses; return their number.

        Args:
            positions: (nbody, 3) world [m].
            quaternions: (nbody, 4) wxyz.
        """
        sent = 0
        for body in self._moving:
            pose = np.concatenate([positions[body], quaternions[body]])
            if np.abs(pose - self._sent[body]).max() >= _MOVED:
                self._sent[body] = pose
                self._frames[body].position = pose[:3]
                self._frames[body].wxyz = pose[3:]
                sent += 1
        return sent

    def draw_forces(self, arrows: Sequence[Arrow]) -> None:
        """Replace the force arrows."""
        shown = [a for a in arrows if float(np.linalg.norm(a.force)) >= _ARROW_MIN_N]
        if self._arrows is not None:
            self._arrows.visible = bool(shown)
        if not shown:
            return
        points = np.array(
            [[a.start, a.start + _ARROW_M_PER_N * a.force] for a in shown],
            dtype=np.float32,
        )
        colours = np.array([a.rgb for a in shown], dtype=np.uint8)
        if self._arrows is None or len(self._arrows.points) != len(points):
            size = {"shaft_radius": 0.006, "head_radius": 0.014, "head_length": 0.03}
            self._arrows = self._server.scene.add_arrows("/forces", points, colours, **size)
        else:
            self._arrows.points = points
            self._arrows.colors = colours

    def draw_preview(self, preview: Preview) -> None:
        """Draw the plan unless it is the same object."""
        if preview is self._preview:
            return
        self._preview = preview
        for node in self._preview_nodes:
            node.remove()
        self._preview_nodes = []
        for line in preview.paths:
            points = np.asarray(line.points, dtype=np.float32)
            pieces = np.stack([points[:-1], points[1:]], axis=1)
            node = self._server.scene.add_line_segments(
                f"/plan/{line.name}",
                pieces,
                line.rgb,
                thickness=0.006,
            )
            self._preview_nodes.append(node)
        for index, qpos in enumerate(preview.ghosts[:_GHOSTS_MAX]):
            self._add_ghost(f"/plan/ghost{index}", qpos)

    def _add_ghost(self, root: str, qpos: Array) -> None:
        data = mujoco.MjData(self._model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, data)
        self._preview_nodes.append(self._server.scene.add_frame(root, show_axes=False))
        poses = {body: np.concatenate([data.xpos[body], data.xquat[body]]) for body in self._moving}
        elsewhere = {
            body
            for body, pose in poses.items()
            if np.abs(pose - self._sent[body]).max() > _GHOST_MOVED
        }
        self._add_bodies(root, data, elsewhere, ghost=True)
