"""Camera checks of `env-check`."""

from pathlib import Path
from typing import NamedTuple

import mujoco
from OpenGL import GL

from minidual.plant.cameras import CAMERAS
from minidual.plant.render import Camera
from minidual.plant.world import World
from minidual.show.figures.canvas import sheet

_KINDS = {"high": "from above", "left": "wrist", "right": "wrist", "overview": "for people"}


class CameraCheck(NamedTuple):
    """Pictures of the cameras.

    Attributes:
        contrast_min: Least standard deviation of brightness (0..255).
        object_share: Least share of `high` that a task object takes.
        fingers_min: The same of a fingertip and its wrist camera.
        gl_renderer: Name of the OpenGL renderer.
    """

    contrast_min: float
    object_share: float
    fingers_min: float
    gl_renderer: str


def check_cameras(world: World, path: Path | None = None) -> CameraCheck:
    """Render the recorded cameras of a world with visuals.

    Args:
        world: Its model has visual meshes.
        path: File of a figure of them and the overview.

    Raises:
        EnvironmentMissingError: No off-screen OpenGL context.
    """
    robot = world.robot
    with Camera(world.model, 480, 360, supersample=2) as camera:
        pictures = {name: camera.picture(world.data, name) for name in (*CAMERAS, "overview")}
        shares = {name: camera.bodies_seen(world.data, name) for name in ("high", *robot.sides)}
        renderer = _gl_renderer()
    if path is not None:
        titled = [(f"{name} ({_KINDS[name]})", picture) for name, picture in pictures.items()]
        sheet(titled, 2, path, width_in=4.8)
    finger_shares = [
        shares[side].get(finger, 0.0) for side in robot.sides for finger in _fingers(world, side)
    ]
    object_shares = [shares["high"].get(name, 0.0) for name in world.objects]
    return CameraCheck(
        contrast_min=min(float(pictures[name].mean(axis=2).std()) for name in CAMERAS),
        object_share=min(object_shares),
        fingers_min=min(finger_shares),
        gl_renderer=renderer,
    )


def _fingers(world: World, side: str) -> list[str]:
    """Return the links of a hand's fingers."""
    _palm, *fingers = world.robot.hand_links(side)
    return fingers


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
