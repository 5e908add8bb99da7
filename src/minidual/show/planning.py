"""Show a plan: the simulated world with the scene's obstacles in it, as a picture or in a live view."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from minidual.collision.scene import TABLE, PlanningScene
from minidual.collision.shapes import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from minidual.config.scene import SceneConfig
from minidual.plant.addresses import map_joints
from minidual.plant.model import GROUP_COLLISION, GROUP_MARKER, GROUP_VISUAL, build_spec
from minidual.robot.constants import ARMS, FINGER_JOINT_NAMES, FINGER_TRAVEL_M, JOINT_NAMES, Array
from minidual.robot.kinematics import Kinematics
from minidual.robot.trajectory import Trajectory
from minidual.show.view.overlay import LEFT_RGB, RIGHT_RGB, Overlay, PathLine, Preview

if TYPE_CHECKING:
    from minidual.show.view import View

_OBSTACLE_RGBA = (0.78, 0.42, 0.25, 1.0)
_HELD_RGBA = (0.15, 0.6, 0.4, 1.0)
_RGB = {"left": LEFT_RGB, "right": RIGHT_RGB}
_PATH_POINTS = 120
_STATIC_M = 1e-6


def scene_model(config: SceneConfig, scene: PlanningScene) -> mujoco.MjModel:
    """Return the simulated world, with visual meshes, holding what the planning scene holds (and no rod)."""
    spec = build_spec(config, visuals=True)
    rod = spec.body("rod")
    for geom in rod.geoms:
        geom.rgba = [0.0, 0.0, 0.0, 0.0]
    for shape in scene.obstacles:
        if shape == TABLE:
            continue
        _add_body(spec, spec.worldbody, shape, _OBSTACLE_RGBA)
    for held in scene.attached:
        _add_body(spec, spec.body(held.link), held.shape, _HELD_RGBA)
    return spec.compile()


def _add_body(spec: Any, parent: Any, shape: Shape, rgba: tuple[float, ...]) -> None:
    body = parent.add_body(name=f"shown_{shape.name}", pos=list(shape.position_m), quat=list(shape.quat_wxyz))
    kind = mujoco.mjtGeom
    look = {"rgba": list(rgba), "contype": 0, "conaffinity": 0, "density": 0.0, "group": GROUP_VISUAL}
    match shape:
        case Box():
            body.add_geom(type=kind.mjGEOM_BOX, size=[0.5 * v for v in shape.size_m], **look)
        case Cylinder():
            body.add_geom(type=kind.mjGEOM_CYLINDER, size=[shape.radius_m, 0.5 * shape.length_m, 0.0], **look)
        case Capsule():
            body.add_geom(type=kind.mjGEOM_CAPSULE, size=[shape.radius_m, 0.5 * shape.length_m, 0.0], **look)
        case Sphere():
            body.add_geom(type=kind.mjGEOM_SPHERE, size=[shape.radius_m, 0.0, 0.0], **look)
        case Mesh():
            for index, vertices in enumerate(shape.vertices()):
                name = f"shown_{shape.name}:{index}"
                spec.add_mesh(name=name, uservert=vertices.ravel())
                body.add_geom(type=kind.mjGEOM_MESH, meshname=name, **look)


class Poser:
    """Places the arms of a shown model.

    Args:
        model: From `scene_model`.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self.data = mujoco.MjData(model)
        self._joints = map_joints(model, JOINT_NAMES, torque=True).qpos
        self.data.qpos[map_joints(model, FINGER_JOINT_NAMES, torque=False).qpos] = FINGER_TRAVEL_M

    def place(self, q: Array) -> mujoco.MjData:
        """Return the state with the arms at q (14,)."""
        self.data.qpos[self._joints] = q
        mujoco.mj_kinematics(self.model, self.data)
        return self.data

    def state(self, q: Array) -> Array:
        """Return the whole state (nq,) with the arms at q (14,)."""
        return self.place(q).qpos.copy()


def tcp_paths(trajectory: Trajectory) -> dict[str, Array]:
    """Return where the tcps that move go, {arm: (n, 3)} [m]."""
    kinematics = Kinematics()
    rows = np.unique(np.linspace(0, len(trajectory.times) - 1, _PATH_POINTS).astype(int))
    tips = np.array([[T[:3, 3] for T in kinematics.tcp_poses(trajectory.q[k])] for k in rows])
    return {arm: tips[:, k] for k, arm in enumerate(ARMS) if np.ptp(tips[:, k], axis=0).max() > _STATIC_M}


def plan_preview(poser: Poser, trajectory: Trajectory) -> Preview:
    """Return what a live view shows of a plan: the ways of the tcps and where the arms end."""
    lines = tuple(PathLine(arm, points, _RGB[arm]) for arm, points in tcp_paths(trajectory).items())
    return Preview(lines, (poser.state(trajectory.q[-1]),))


def play(
    view: View,
    config: SceneConfig,
    scene: PlanningScene,
    trajectory: Trajectory,
    title: str,
    *,
    rounds_n: int | None,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Show a plan at its own pace, again and again.

    Args:
        view: Live view, not open yet.
        config: Of the world around.
        scene: That the plan was made in.
        trajectory: The plan.
        title: Shown beside it.
        rounds_n: How often; None goes on until the view is closed.
        sleep: Waits [s].
    """
    poser = Poser(scene_model(config, scene))
    preview = plan_preview(poser, trajectory)
    view.open(poser.model)
    done = 0
    while view.alive and (rounds_n is None or done < rounds_n):
        began = time.monotonic()
        t = 0.0
        while view.alive and t < trajectory.duration_s + 1.0:
            t = time.monotonic() - began
            if view.due():
                q, _, _ = trajectory.sample(t)
                view.update(
                    poser.place(q),
                    Overlay(
                        min(t, trajectory.duration_s),
                        title=title,
                        mode="moveit",
                        source="planner",
                        status=f"{trajectory.duration_s:.2f} s of motion, round {done + 1}",
                        preview=preview,
                    ),
                )
            sleep(0.005)
        done += 1


def write_picture(path: Path, config: SceneConfig, scene: PlanningScene, trajectory: Trajectory, title: str) -> None:
    """Draw a plan: the world from the front corner and from above, arms at the end, pale at the start and between."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    poser = Poser(scene_model(config, scene))
    views = [_render(poser, trajectory, camera) for camera in (_corner_camera(), _top_camera())]
    figure = Figure(figsize=(13.0, 5.6), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    for axis, image, name in zip(
        figure.subplots(1, 2), views, ("from the front corner", "from above, the arms' bases on the left"), strict=True
    ):
        axis.imshow(image)
        axis.set_axis_off()
        axis.set_title(name, fontsize=10)
    figure.suptitle(f"{title}: pale where it begins and passes, solid where it ends", fontsize=12)
    figure.savefig(path)


def _corner_camera() -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (0.3, 0.0, 0.25)
    camera.distance, camera.azimuth, camera.elevation = 2.1, 148.0, -28.0
    return camera


def _top_camera() -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (0.35, 0.0, 0.1)
    camera.distance, camera.azimuth, camera.elevation = 2.3, 90.0, -89.0
    return camera


def _render(poser: Poser, trajectory: Trajectory, camera: mujoco.MjvCamera) -> Any:
    renderer = mujoco.Renderer(poser.model, 720, 840, max_geom=20_000)
    option = mujoco.MjvOption()
    option.geomgroup[GROUP_COLLISION] = option.geomgroup[GROUP_MARKER] = 0
    try:
        renderer.update_scene(poser.place(trajectory.q[-1]), camera, scene_option=option)
        for fraction, alpha in ((0.0, 0.35), (1.0 / 3.0, 0.14), (2.0 / 3.0, 0.14)):
            _add_ghost(renderer.scene, poser, trajectory.sample(fraction * trajectory.duration_s)[0], option, alpha)
        for arm, points in tcp_paths(trajectory).items():
            _add_line(renderer.scene, points, _RGB[arm])
        return renderer.render()
    finally:
        renderer.close()


def _add_ghost(shown: Any, poser: Poser, q: Array, option: mujoco.MjvOption, alpha: float) -> None:
    """Add the arms at q (14,) once more, pale."""
    before = shown.ngeom
    mujoco.mjv_addGeoms(
        poser.model, poser.place(q), option, mujoco.MjvPerturb(), int(mujoco.mjtCatBit.mjCAT_DYNAMIC), shown
    )
    for geom in shown.geoms[before : shown.ngeom]:
        geom.rgba[3] *= alpha


def _add_line(shown: Any, points: Array, rgb: Sequence[int]) -> None:
    colour = np.array([*(v / 255.0 for v in rgb), 1.0], dtype=np.float32)
    for a, b in itertools.pairwise(points):
        if shown.ngeom >= shown.maxgeom:
            return
        geom = shown.geoms[shown.ngeom]
        mujoco.mjv_initGeom(geom, int(mujoco.mjtGeom.mjGEOM_CAPSULE), np.zeros(3), np.zeros(3), np.zeros(9), colour)
        mujoco.mjv_connector(geom, int(mujoco.mjtGeom.mjGEOM_CAPSULE), 0.006, a, b)
        shown.ngeom += 1
