"""The scene in the browser: built once, then only poses, arrows and lines are sent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from minidual.show.view.overlay import NO_PREVIEW, Array, Arrow, Preview
from minidual.show.view.shapes import BodyMesh, body_meshes, floor_height, moving_bodies

ARROW_M_PER_N = 0.0025
"""Length of a force arrow: 40 N are 10 cm."""
ARROW_MIN_N = 0.5
_MOVED = 1e-5
"""Least change of a position [m] or quaternion entry that is sent; the screen shows 1 mm at best."""
_FLAT_M = 0.002
"""A mesh thinner than this, such as a mark on the table, would only cast a blurred shadow on itself."""
_GHOSTS_MAX, _GHOST_MOVED = 4, 1e-3
_GHOST_RGB = (70, 160, 255)
_BACKGROUND_RGB = (255, 255, 255)
_CAMERA, _TARGET, _FOV_RAD = (1.85, -0.85, 0.95), (0.30, 0.10, 0.17), 0.70


class WebScene:
    """What the browser draws for one model.

    Args:
        server: A viser server; what a scene before drew is removed.
        model: With visual meshes.
    """

    def __init__(self, server: Any, model: mujoco.MjModel) -> None:
        self._server = server
        self._model = model
        self._meshes = body_meshes(model)
        self._moving = moving_bodies(model)
        self._arrows: Any = None
        self._preview: Preview = NO_PREVIEW
        self._preview_nodes: list[Any] = []
        scene = server.scene
        scene.reset()
        self._light()
        height = floor_height(model)
        if height is not None:
            self._add_floor(height)
        drawn = {mesh.body for mesh in self._meshes}
        self._moving = [body for body in self._moving if body in drawn]
        self._frames = {body: self._add_frame(f"/scene/{_name(model, body)}") for body in sorted(drawn)}
        self._sent = {body: np.full(7, np.inf) for body in self._moving}
        for index, mesh in enumerate(self._meshes):
            self._add_mesh(f"/scene/{_name(model, mesh.body)}/mesh{index}", mesh)
        rest = mujoco.MjData(model)
        mujoco.mj_kinematics(model, rest)
        for body, frame in self._frames.items():
            frame.position, frame.wxyz = rest.xpos[body].copy(), rest.xquat[body].copy()

    @property
    def moving(self) -> Sequence[int]:
        """Bodies whose poses are sent."""
        return self._moving

    def _light(self) -> None:
        server = self._server
        server.scene.set_up_direction("+z")
        server.scene.configure_environment_map("studio", background=False, environment_intensity=0.22)
        server.scene.configure_default_lights(enabled=False)
        server.scene.add_light_hemisphere(
            "/light/sky", sky_color=(255, 255, 255), ground_color=(120, 126, 138), intensity=0.42
        )
        server.scene.add_light_directional(
            "/light/key", color=(255, 250, 240), intensity=1.15, cast_shadow=True, position=(1.2, 1.0, 2.6)
        )
        server.initial_camera.position = _CAMERA
        server.initial_camera.look_at = _TARGET
        server.initial_camera.up = (0.0, 0.0, 1.0)
        server.initial_camera.fov = _FOV_RAD
        server.initial_camera.near, server.initial_camera.far = 0.05, 60.0
        server.scene.configure_fog(4.0, 14.0, color=_BACKGROUND_RGB)

    def _add_floor(self, height_m: float) -> None:
        half = 30.0  # its edge lies in the fog
        corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]], np.float32)
        self._server.scene.add_mesh_simple(
            "/floor",
            corners,
            np.array([[0, 1, 2], [0, 2, 3]]),
            color=(214, 220, 228),
            position=(0.0, 0.0, height_m),
            cast_shadow=False,
        )

    def _add_frame(self, name: str) -> Any:
        return self._server.scene.add_frame(name, show_axes=False)

    def _add_mesh(self, name: str, mesh: BodyMesh, *, ghost: bool = False) -> Any:
        rgb = _GHOST_RGB if ghost else tuple(round(255 * c) for c in mesh.rgba[:3])
        opacity = 0.28 if ghost else (mesh.rgba[3] if mesh.rgba[3] < 1.0 else None)
        flat = float(np.ptp(mesh.vertices, axis=0).min()) < _FLAT_M
        return self._server.scene.add_mesh_simple(
            name,
            mesh.vertices,
            mesh.faces,
            color=rgb,
            opacity=opacity,
            cast_shadow=not (ghost or flat),
            receive_shadow=not ghost,
        )

    def move(self, positions: Array, quaternions: Array) -> int:
        """Send the poses of the moving bodies that changed; return how many did.

        Args:
            positions: (nbody, 3) world [m].
            quaternions: (nbody, 4) wxyz.
        """
        sent = 0
        for body in self._moving:
            pose = np.concatenate([positions[body], quaternions[body]])
            if np.abs(pose - self._sent[body]).max() < _MOVED:
                continue
            self._sent[body] = pose
            frame = self._frames[body]
            frame.position, frame.wxyz = pose[:3], pose[3:]
            sent += 1
        return sent

    def draw_forces(self, arrows: Sequence[Arrow]) -> None:
        """Draw forces as arrows; the ones before vanish."""
        shown = [a for a in arrows if float(np.linalg.norm(a.force)) >= ARROW_MIN_N]
        if not shown:
            if self._arrows is not None:
                self._arrows.visible = False
            return
        points = np.array([[a.start, a.start + ARROW_M_PER_N * a.force] for a in shown], dtype=np.float32)
        colours = np.array([a.rgb for a in shown], dtype=np.uint8)
        if self._arrows is None or len(self._arrows.points) != len(points):
            self._arrows = self._server.scene.add_arrows(
                "/forces", points, colours, shaft_radius=0.006, head_radius=0.014, head_length=0.03
            )
        else:
            self._arrows.points, self._arrows.colors = points, colours
        self._arrows.visible = True

    def draw_preview(self, preview: Preview) -> None:
        """Draw what is planned; the same object as before is drawn already."""
        if preview is self._preview:
            return
        self._preview = preview
        for node in self._preview_nodes:
            node.remove()
        self._preview_nodes = []
        for line in preview.paths:
            points = np.asarray(line.points, dtype=np.float32)
            self._preview_nodes.append(
                self._server.scene.add_line_segments(
                    f"/plan/{line.name}", np.stack([points[:-1], points[1:]], axis=1), line.rgb, thickness=0.006
                )
            )
        for index, qpos in enumerate(preview.ghosts[:_GHOSTS_MAX]):
            self._add_ghost(index, qpos)

    def _add_ghost(self, index: int, qpos: Array) -> None:
        data = mujoco.MjData(self._model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, data)
        root = self._server.scene.add_frame(f"/plan/ghost{index}", show_axes=False)
        self._preview_nodes.append(root)
        poses = {body: np.concatenate([data.xpos[body], data.xquat[body]]) for body in self._moving}
        # What stays where it is, such as the object on the table, would only be drawn twice.
        elsewhere = {b for b, pose in poses.items() if np.abs(pose - self._sent[b]).max() > _GHOST_MOVED}
        for body in elsewhere:
            frame = self._add_frame(f"/plan/ghost{index}/{_name(self._model, body)}")
            frame.position, frame.wxyz = data.xpos[body].copy(), data.xquat[body].copy()
        for number, mesh in enumerate(self._meshes):
            if mesh.body in elsewhere:
                name = f"/plan/ghost{index}/{_name(self._model, mesh.body)}/mesh{number}"
                self._add_mesh(name, mesh, ghost=True)


def _name(model: mujoco.MjModel, body: int) -> str:
    """Return a name without slashes, unique in the model: the browser's tree splits at slashes."""
    return f"{body}_{model.body(body).name.replace('/', '_')}"
