"""Camera checks and figures of `env-check`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from OpenGL import GL

from minidual.plant.model import CAMERAS
from minidual.plant.render import Camera, Image, write_video
from minidual.plant.world import World
from minidual.robot.pair import Robot
from minidual.show.figures.canvas import BLUE, INK, ORANGE, limit_line, new_figure, sheet
from minidual.stages.env_check.tracking import JointResponse, Tracking


@dataclass(frozen=True)
class CameraCheck:
    """What the cameras see, as shares of a picture (0..1) unless noted.

    Attributes:
        contrast_min: Least standard deviation of brightness (0..255); 0 is one flat colour.
        object_share: Least share of a task object in `high`.
        fingers_min: Least share of a fingertip in its wrist camera.
    """

    contrast_min: float
    object_share: float
    fingers_min: float
    gl_renderer: str


def check_cameras(world: World, *, width_px: int = 320, height_px: int = 240) -> CameraCheck:
    """Render the recorded cameras of a world with visuals.

    Raises:
        EnvironmentMissingError: No off-screen OpenGL context.
    """
    with Camera(world.model, width_px, height_px) as camera:
        pictures = {name: camera.picture(world.data, name) for name in CAMERAS}
        fingers = [
            camera.bodies_seen(world.data, side).get(finger, 0.0)
            for side in world.robot.sides
            for finger in world.robot.hand_links(side)[1:]
        ]
        objects = [camera.bodies_seen(world.data, "high").get(name, 0.0) for name in world.objects]
        renderer = _gl_renderer()
    contrast = min(float(picture.mean(axis=2).std()) for picture in pictures.values())
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
    """Return the renderer of the current OpenGL context."""
    name = GL.glGetString(GL.GL_RENDERER)
    return name.decode() if isinstance(name, bytes) else "unknown"


def film(world: World, tracking: Tracking, path: Path, *, fps: int, width_px: int, height_px: int) -> int:
    """Film a tracking run by the overview camera as mp4; return the number of frames."""
    data = mujoco.MjData(world.model)
    duration = tracking.t[-1]
    indices = np.searchsorted(tracking.t, np.arange(round(duration * fps)) / fps + tracking.t[0] - 1e-9)

    def frames(camera: Camera) -> Iterator[Image]:
        for index in indices:
            data.qpos[:] = tracking.qpos[index]
            mujoco.mj_forward(world.model, data)
            yield camera.picture(data, "overview")

    with Camera(world.model, width_px, height_px) as camera:
        return write_video(path, frames(camera), fps=fps)


def save_cameras(world: World, path: Path) -> None:
    """Save a figure of the recorded cameras and the overview."""
    with Camera(world.model, 480, 360, supersample=2) as camera:
        pictures = {name: camera.picture(world.data, name) for name in (*CAMERAS, "overview")}
    kinds = {"high": "recorded", "left": "wrist, recorded", "right": "wrist, recorded", "overview": "for people"}
    sheet([(f"{name} ({kinds[name]})", picture) for name, picture in pictures.items()], 2, path, width_in=4.8)


def save_tracking(
    path: Path,
    robot: Robot,
    step: Tracking,
    steps: Sequence[Tracking],
    sine: Tracking,
    rows: Sequence[JointResponse],
    *,
    step_limit_rad: float,
    sine_limit_rad: float,
    rise_limit_s: float,
) -> None:
    """Save a figure of the steps, the swing and their errors.

    Args:
        path: PNG to write.
        robot: The arms.
        step: Step of joint 1 of both arms.
        steps: Step of each joint alone.
        sine: Swing of all joints.
        rows: Numbers of `steps` and `sine`.
        step_limit_rad: Error limit after the step.
        sine_limit_rad: RMS limit of the swing.
        rise_limit_s: Limit on the rise time.
    """
    figure, ((both, norm, alone), (swing, errors, rise)) = new_figure(2, 3, 15.0, 7.2)
    n, x, every = robot.dof_per_arm, np.arange(robot.dof), max(1, len(sine.t) // 2000)
    for j in range(robot.dof):
        arm = j // n
        style: dict[str, Any] = {"color": (BLUE, ORANGE)[arm], "lw": 1.0}
        if j % n == 0:
            both.plot(step.t, step.reference[:, j], ls="--", alpha=0.6, **style)
            both.plot(step.t, step.measured[:, j], label=f"{robot.sides[arm]} joint 1", **style)
            style["label"] = f"{robot.sides[arm]} arm"
        alone.plot(steps[j].t, steps[j].share(j), ls=("-", (0, (4, 4)))[arm], **style)  # the arms answer alike
        swing.plot(sine.t[::every], 1e3 * (sine.measured - sine.reference)[::every, j], alpha=0.55, **style)
    norm.semilogy(step.t, np.maximum(step.error_norm, 1e-16), color=INK)
    limit_line(norm, step_limit_rad, f"limit {step_limit_rad:g} rad")
    colours = np.repeat([BLUE, ORANGE], n)
    errors.bar(x - 0.2, 1e3 * sine.joint_rms, width=0.38, color=colours, label="RMS while all swing")
    left = [1e3 * row.settled_rad for row in rows]
    errors.bar(x + 0.2, left, width=0.38, color=colours, alpha=0.4, label="left after its own step")
    limit_line(errors, 1e3 * sine_limit_rad, f"limit of the swing, {sine_limit_rad:g} rad")
    errors.set_yscale("log")
    rise.bar(x, [1e3 * row.rise_s for row in rows], width=0.7, color=colours, alpha=0.85)
    limit_line(rise, 1e3 * rise_limit_s, f"limit {1e3 * rise_limit_s:g} ms")
    texts = {
        both: ("Step of joint 1, both arms", "time [s]", "position [rad]"),
        norm: (f"Error left of the step: {step.settled:.1e} rad", "time [s]", "error norm of all joints [rad]"),
        alone: (f"A step of {abs(rows[0].step_rad):g} rad, each joint alone", "time [s]", "share of the step"),
        swing: (f"All {robot.dof} joints swinging: RMS {1e3 * sine.rms:.2g} mrad", "time [s]", "error [mrad]"),
        errors: ("Each joint", "joint", "error [mrad]"),
        rise: ("Rise time of its own step, 10 % to 90 %", "joint", "time [ms]"),
    }
    for axes, (title, across, up) in texts.items():
        axes.set(title=title, xlabel=across, ylabel=up)
        axes.legend(frameon=False, fontsize=8)
    for axes in (errors, rise):
        axes.set_xticks(x, [f"{'LR'[j // n]}{j % n + 1}" for j in x], fontsize=8)
    figure.savefig(path, metadata={"Software": None})  # no date inside: the same run writes the same bytes
