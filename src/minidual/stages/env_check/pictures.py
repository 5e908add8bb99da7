"""Camera checks of `env-check`."""

from pathlib import Path
from typing import NamedTuple

import mujoco
from OpenGL import GL

from minidual.plant.cameras import CAMERAS
from minidual.plant.render import Camera
from minidual.plant.world import World
from minidual.show.figures.canvas import sheet


class CameraCheck(NamedTuple):
    """What the cameras see.

    Attributes:
        contrast_min: Least standard deviation of brightness (0..255).
        object_share: Least share of `high` that a task object takes.
        fingers_min: The same of a fingertip and its wrist camera.
    """

    contrast_min: float
    object_share: float
    fingers_min: float
    gl_renderer: str


def check_cameras(world: World, path: Path | None = None) -> CameraCheck:
    """Render the recorded cameras of a world with visuals; save a figure of them and the overview.

    Raises:
        EnvironmentMissingError: No off-screen OpenGL context.
    """
    with Camera(world.model, 480, 360, supersample=2) as camera:
        pictures = {name: camera.picture(world.data, name) for name in (*CAMERAS, "overview")}
        seen = {name: camera.bodies_seen(world.data, name) for name in ("high", *world.robot.sides)}
        fingers = [
            seen[side].get(f, 0.0)
            for side in world.robot.sides
            for f in world.robot.hand_links(side)[1:]
        ]
        objects = [seen["high"].get(name, 0.0) for name in world.objects]
        renderer = _gl_renderer()
    if path is not None:
        kinds = {"high": "from above", "left": "wrist", "right": "wrist", "overview": "for people"}
        sheet(
            [(f"{name} ({kinds[name]})", picture) for name, picture in pictures.items()],
            2,
            path,
            width_in=4.8,
        )
    contrast = min(float(pictures[name].mean(axis=2).std()) for name in CAMERAS)
    return CameraCheck(contrast, min(objects), min(fingers), renderer)


def renderer_name() -> str:
    """Return the name of the off-screen OpenGL renderer.

    Raises:
        EnvironmentMissingError: No off-screen OpenGL context.
    """
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><camera name='eye'/></worldbody></mujoco>",
    )
    with Camera(model, 32, 32) as camera:
        camera.picture(mujoco.MjData(model), "eye")
        return _gl_renderer()


def _gl_renderer() -> str:
    name = GL.glGetString(GL.GL_RENDERER)
    return name.decode() if isinstance(name, bytes) else "unknown"
