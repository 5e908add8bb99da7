"""Camera checks and figures of `env-check`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from OpenGL import GL

from minidual.config.control import EnvCheckConfig
from minidual.plant.model import CAMERAS
from minidual.plant.render import Camera
from minidual.plant.world import World
from minidual.robot.pair import Robot
from minidual.show.figures.canvas import BLUE, INK, ORANGE, limit_line, new_figure, sheet
from minidual.stages.env_check.tracking import JointResponse, Tracking


@dataclass(frozen=True)
class CameraCheck:
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
        fingers = [
            camera.bodies_seen(world.data, side).get(finger, 0.0)
            for side in world.robot.sides
            for finger in world.robot.hand_links(side)[1:]
        ]
        objects = [camera.bodies_seen(world.data, "high").get(name, 0.0) for name in world.objects]
        renderer = _gl_renderer()
    if path is not None:
        kinds = {"high": "recorded", "left": "wrist, recorded", "right": "wrist, recorded", "overview": "for people"}
        sheet([(f"{name} ({kinds[name]})", picture) for name, picture in pictures.items()], 2, path, width_in=4.8)
    contrast = min(float(pictures[name].mean(axis=2).std()) for name in CAMERAS)
    return CameraCheck(contrast, min(objects), min(fingers), renderer)


def renderer_name() -> str:
    """Return the name of the off-screen OpenGL renderer.

    Raises:
        EnvironmentMissingError: No off-screen OpenGL context.
    """
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><camera name='eye'/></worldbody></mujoco>")
    with Camera(model, 32, 32) as camera:
        camera.picture(mujoco.MjData(model), "eye")
        return _gl_renderer()


def _gl_renderer() -> str:
    name = GL.glGetString(GL.GL_RENDERER)
    return name.decode() if isinstance(name, bytes) else "unknown"


def save_tracking(
    path: Path,
    robot: Robot,
    limits: EnvCheckConfig,
    step: Tracking,
    steps: list[Tracking],
    sine: Tracking,
    rows: list[JointResponse],
) -> None:
    """Save a figure of the steps, the swing, their errors and the rise times."""
    figure, ((norm, alone), (swing, rise)) = new_figure(2, 2, 11.0, 7.2)
    n, x, every = robot.dof_per_arm, np.arange(robot.dof), max(1, len(sine.t) // 2000)
    colours = np.repeat([BLUE, ORANGE], n)
    for j in range(robot.dof):
        label = f"{robot.sides[j // n]} arm" if j % n == 0 else None
        style: dict[str, Any] = {"color": colours[j], "lw": 1.0, "label": label}
        alone.plot(steps[j].t, steps[j].share(j), ls=("-", (0, (4, 4)))[j // n], **style)  # the arms answer alike
        swing.plot(sine.t[::every], 1e3 * (sine.measured - sine.reference)[::every, j], alpha=0.55, **style)
    norm.semilogy(step.t, np.maximum(step.error_norm, 1e-16), color=INK)
    limit_line(norm, limits.step_error_max_rad, f"limit {limits.step_error_max_rad:g} rad")
    rise.bar(x, [1e3 * row["rise_s"] for row in rows], width=0.7, color=colours, alpha=0.85)
    limit_line(rise, 1e3 * limits.rise_max_s, f"limit {1e3 * limits.rise_max_s:g} ms")
    rise.set_xticks(x, [f"{'LR'[j // n]}{j % n + 1}" for j in x], fontsize=8)
    texts = {
        norm: (f"Step of joint 1 of both arms leaves {step.settled:.1e} rad", "time [s]", "error of all joints [rad]"),
        alone: (f"A step of {abs(rows[0]['step_rad']):g} rad, each joint alone", "time [s]", "share of the step"),
        swing: (f"All {robot.dof} joints swinging: RMS {1e3 * sine.rms:.2g} mrad", "time [s]", "error [mrad]"),
        rise: ("Rise time of each joint's own step, 10 % to 90 %", "joint", "time [ms]"),
    }
    for axes, (title, across, up) in texts.items():
        axes.set(title=title, xlabel=across, ylabel=up)
        axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, metadata={"Software": None})  # no date inside: the same run writes the same bytes
