"""Browser scene: built once, then updated."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from minidual.plant.marks import goal_mark
from minidual.show.view.meshes import BodyMesh, body_meshes, goal_mesh, moving_bodies
from minidual.show.view.overlay import (
    ARROW_M_PER_N,
    NO_PREVIEW,
    Array,
    Arrow,
    PathLine,
    Preview,
)

_ARROW_MIN_N = 0.5
_MOVED = 1e-5
"""Least change [m, quaternion] that is sent."""
_GHOSTS_MAX = 4
_GHOST_MOVED = 1e-3
"""Least change [m, quaternion] for which a body of a ghost is drawn."""
_GHOST_RGB = (70, 160, 255)
_GHOST_OPACITY = 0.28
_FLOOR_RGB = (214, 220, 228)
_FLOOR_HALF_M = 30.0  # hides the floor's edge in fog
_FOG_RGB = (255, 255, 255)
_CAMERA = (1.88, -0.50, 1.05)  # nearly in front: neither arm stands before the other one
_TARGET = (0.28, 0.06, 0.22)
_FARTHER_PER_ROOM = 0.7
_FOV_RAD = 0.70


class Scene:
    """Scene of a model with visual meshes; resets the server's scene."""

    def __init__(
        self,
        server: Any,
        model: mujoco.MjModel,
        *,
        rooms_n: int = 1,
        shadows: bool = True,
    ) -> None:
        self._server = server
        self._model = model
        self._meshes = body_meshes(model)
        self._arrows: Any = None
        self._preview: Preview = NO_PREVIEW
        self._preview_nodes: list[Any] = []
        server.scene.reset()
        self._light(shadows)
        self._place_camera(rooms_n)
        self._add_floor()
        at_rest = mujoco.MjData(model)
        mujoco.mj_kinematics(model, at_rest)
        drawn = {mesh.body for mesh in self._meshes}
        self._frames = self._add_bodies("/scene", at_rest, drawn)
        self._goal = self._add_goal()
        self._moving = [body for body in moving_bodies(model) if body in drawn]
        self._sent: dict[int, Array] = {body: np.full(7, np.inf) for body in self._moving}

    def _light(self, shadows: bool) -> None:
        scene = self._server.scene
        scene.set_up_direction("+z")
        scene.configure_environment_map("studio", background=False, environment_intensity=0.22)
        scene.configure_default_lights(enabled=False)
        scene.add_light_hemisphere("/light/sky", ground_color=(120, 126, 138), intensity=0.42)
        scene.add_light_directional(
            "/light/key",
            color=(255, 250, 240),
            intensity=1.15,
            cast_shadow=shadows,
            position=(1.2, 1.0, 2.6),
        )
        scene.configure_fog(4.0, 14.0, color=_FOG_RGB)

    def _place_camera(self, rooms_n: int) -> None:
        camera = self._server.initial_camera
        distance = 1.0 + _FARTHER_PER_ROOM * (rooms_n - 1)
        camera.position = tuple(distance * np.subtract(_CAMERA, _TARGET) + _TARGET)
        camera.look_at = _TARGET
        camera.up = (0.0, 0.0, 1.0)
        camera.fov = _FOV_RAD
        camera.near = 0.05
        camera.far = 60.0

    def _add_floor(self) -> None:
        """Draw the model's ground plane, if it has one."""
        planes = np.flatnonzero(self._model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
        if not len(planes):
            return
        corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float32)
        self._server.scene.add_mesh_simple(
            "/floor",
            _FLOOR_HALF_M * corners,
            np.array([[0, 1, 2], [0, 2, 3]]),
            color=_FLOOR_RGB,
            position=(0.0, 0.0, float(self._model.geom_pos[planes[0], 2])),
            cast_shadow=False,
        )

    def _add_bodies(
        self,
        root: str,
        data: mujoco.MjData,
        bodies: set[int],
        *,
        ghost: bool = False,
    ) -> dict[int, Any]:
        """Add bodies at their poses in `data`; return their frames."""
        frames: dict[int, Any] = {}
        names: dict[int, str] = {}
        for body in sorted(bodies):
            names[body] = f"{root}/{body}_{self._model.body(body).name.replace('/', '_')}"
            frames[body] = self._server.scene.add_frame(
                names[body],
                show_axes=False,
                position=data.xpos[body].copy(),
                wxyz=data.xquat[body].copy(),
            )
        for index, mesh in enumerate(self._meshes):
            if mesh.body not in bodies:
                continue
            name = f"{names[mesh.body]}/mesh{index}"
            if ghost:
                self._add_ghost_mesh(name, mesh)
            else:
                self._add_mesh(name, mesh)
        return frames

    def _add_mesh(self, name: str, mesh: BodyMesh) -> None:
        *rgb, opacity = mesh.rgba
        self._server.scene.add_mesh_simple(
            name,
            mesh.vertices,
            mesh.faces,
            color=tuple(round(255 * channel) for channel in rgb),
            opacity=opacity if opacity < 1.0 else None,
            cast_shadow=not mesh.is_flat,
            receive_shadow=True,
        )

    def _add_goal(self) -> Any:
        """Draw the goal's mark where the model has it; return its frame, None without a mark."""
        mesh = goal_mesh(self._model)
        geom = goal_mark(self._model)
        if mesh is None or geom is None:
            return None
        frame = self._server.scene.add_frame(
            "/scene/goal",
            show_axes=False,
            position=self._model.geom_pos[geom].copy(),
            wxyz=self._model.geom_quat[geom].copy(),
        )
        self._add_mesh("/scene/goal/mesh", mesh)
        return frame

    def mark_goal(self, pose: Array | None) -> None:
        """Move the goal's mark to a pose (7,), position [m] and quaternion wxyz, if it changed."""
        if self._goal is None or pose is None:
            return
        drawn = np.concatenate([self._goal.position, self._goal.wxyz])
        if np.abs(pose - drawn).max() >= _MOVED:
            self._goal.position = pose[:3]
            self._goal.wxyz = pose[3:]

    def _add_ghost_mesh(self, name: str, mesh: BodyMesh) -> None:
        self._server.scene.add_mesh_simple(
            name,
            mesh.vertices,
            mesh.faces,
            color=_GHOST_RGB,
            opacity=_GHOST_OPACITY,
            cast_shadow=False,
            receive_shadow=False,
        )

    def move(self, positions: Array, quaternions: Array) -> int:
        """Send changed poses; return their number.

        Args:
            positions: (nbody, 3) world [m].
            quaternions: (nbody, 4) wxyz.
        """
        sent_n = 0
        for body in self._moving:
            pose = np.concatenate([positions[body], quaternions[body]])
            if np.abs(pose - self._sent[body]).max() >= _MOVED:
                self._sent[body] = pose
                self._frames[body].position = pose[:3]
                self._frames[body].wxyz = pose[3:]
                sent_n += 1
        return sent_n

    def draw_forces(self, arrows: Sequence[Arrow]) -> None:
        """Replace the force arrows."""
        shown = [arrow for arrow in arrows if float(np.linalg.norm(arrow.force)) >= _ARROW_MIN_N]
        if self._arrows is not None:
            self._arrows.visible = bool(shown)
        if not shown:
            return
        ends = [[arrow.start, arrow.start + ARROW_M_PER_N * arrow.force] for arrow in shown]
        points = np.array(ends, dtype=np.float32)
        colours = np.array([arrow.rgb for arrow in shown], dtype=np.uint8)
        if self._arrows is None or len(self._arrows.points) != len(points):
            self._arrows = self._server.scene.add_arrows(
                "/forces",
                points,
                colours,
                shaft_radius=0.006,
                head_radius=0.014,
                head_length=0.03,
            )
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
            self._add_path(line)
        for index, qpos in enumerate(preview.ghosts[:_GHOSTS_MAX]):
            self._add_ghost(f"/plan/ghost{index}", qpos)

    def _add_path(self, line: PathLine) -> None:
        points = np.asarray(line.points, dtype=np.float32)
        segments = np.stack([points[:-1], points[1:]], axis=1)
        node = self._server.scene.add_line_segments(
            f"/plan/{line.name}",
            segments,
            line.rgb,
            thickness=0.006,
        )
        self._preview_nodes.append(node)

    def _add_ghost(self, root: str, qpos: Array) -> None:
        """Add the bodies that `qpos` (nq,) moves away from where they are."""
        data = mujoco.MjData(self._model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, data)
        self._preview_nodes.append(self._server.scene.add_frame(root, show_axes=False))
        moved: set[int] = set()
        for body in self._moving:
            pose = np.concatenate([data.xpos[body], data.xquat[body]])
            if np.abs(pose - self._sent[body]).max() > _GHOST_MOVED:
                moved.add(body)
        self._add_bodies(root, data, moved, ghost=True)
