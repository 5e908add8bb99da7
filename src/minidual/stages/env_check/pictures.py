"""What the cameras see, and the pictures of the environment check: film of the swing, cameras, tracking."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from OpenGL import GL

from minidual.plant.model import CAMERAS
from minidual.plant.render import Camera, Image, write_video
from minidual.plant.world import World
from minidual.robot.pair import Robot
from minidual.stages.env_check.tracking import JointResponse, Tracking

_LEFT, _RIGHT, _GREY, _LIMIT = "#1f5fa8", "#d1661b", "#5b6670", "#b3261e"


@dataclass(frozen=True)
class CameraCheck:
    """What the pictures hold, as shares of a picture (0..1) unless said otherwise.

    Attributes:
        contrast_min: Least standard deviation of brightness (0..255) among the cameras; 0 is one flat colour.
        object_share: Least share of an object of the task in `high`.
        fingers_min: Least share of a fingertip in the camera of its own wrist, over four fingers.
        gl_renderer: Name of the OpenGL renderer, for the bill of versions.
    """

    contrast_min: float
    object_share: float
    fingers_min: float
    gl_renderer: str


def check_cameras(world: World, *, width_px: int = 320, height_px: int = 240) -> CameraCheck:
    """Render the recorded cameras of a world compiled with visuals, as it stands.

    Raises:
        EnvironmentMissingError: No off-screen OpenGL context can be made.
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
    """Return the name of the OpenGL renderer that draws without a screen.

    Raises:
        EnvironmentMissingError: No off-screen OpenGL context can be made.
    """
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><camera name='eye'/></worldbody></mujoco>")
    with Camera(model, 32, 32) as camera:
        camera.picture(mujoco.MjData(model), "eye")
        return _gl_renderer()


def _gl_renderer() -> str:
    """Return the name of the renderer behind the current OpenGL context."""
    name = GL.glGetString(GL.GL_RENDERER)
    return name.decode() if isinstance(name, bytes) else "unknown"


def film(world: World, tracking: Tracking, path: Path, *, fps: int, width_px: int, height_px: int) -> int:
    """Draw the states of a tracking run, seen by the overview camera, as an mp4; return the number of frames."""
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
    """Save one figure of the three recorded cameras and the overview."""
    with Camera(world.model, 480, 360, supersample=2) as camera:
        pictures = {name: camera.picture(world.data, name) for name in (*CAMERAS, "overview")}
    titles = {
        "high": "high (recorded)",
        "left": "left wrist (recorded)",
        "right": "right wrist (recorded)",
        "overview": "overview (for people)",
    }
    figure = _figure(9.6, 7.6)
    for place, (name, picture) in enumerate(pictures.items()):
        axes = figure.add_subplot(2, 2, place + 1)
        axes.imshow(picture)
        axes.set_title(titles[name], fontsize=10, loc="left", color=_GREY)
        axes.set_axis_off()
    _save(figure, path)


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
    """Save one figure: the step of joint 1 of both arms, each joint's own step, the swing, and the error of each.

    Args:
        path: PNG to write.
        robot: Its arms.
        step: Step of joint 1 of both arms.
        steps: The step of each joint alone.
        sine: Swing of all joints.
        rows: Numbers of `steps` and `sine`.
        step_limit_rad: Limit on the error after the step.
        sine_limit_rad: Limit on the RMS of the swing.
        rise_limit_s: Limit on the rise time.
    """
    figure = _figure(15.0, 7.2)
    (both, norm, alone), (swing, errors, rise) = figure.subplots(2, 3)
    n, x, every = robot.dof_per_arm, np.arange(robot.dof), max(1, len(sine.t) // 2000)
    for j in range(robot.dof):
        arm = j // n
        style: dict[str, Any] = {"color": (_LEFT, _RIGHT)[arm], "lw": 1.0}
        if j % n == 0:
            both.plot(step.t, step.reference[:, j], ls="--", alpha=0.6, **style)
            both.plot(step.t, step.measured[:, j], label=f"{robot.sides[arm]} joint 1", **style)
            style["label"] = f"{robot.sides[arm]} arm"
        alone.plot(steps[j].t, steps[j].share(j), ls=("-", (0, (4, 4)))[arm], **style)  # the arms answer alike
        swing.plot(sine.t[::every], 1e3 * (sine.measured - sine.reference)[::every, j], alpha=0.55, **style)
    norm.semilogy(step.t, np.maximum(step.error_norm, 1e-16), color=_GREY, lw=1.6)
    norm.axhline(step_limit_rad, color=_LIMIT, lw=1, ls="--", label=f"limit {step_limit_rad:g} rad")
    alone.axhline(1.0, color=_GREY, lw=0.8, ls=":")
    colours = np.repeat([_LEFT, _RIGHT], n)
    errors.bar(x - 0.2, 1e3 * sine.joint_rms, width=0.38, color=colours, label="RMS while all swing")
    left = [1e3 * row.settled_rad for row in rows]
    errors.bar(x + 0.2, left, width=0.38, color=colours, alpha=0.4, label="left after its own step")
    errors.axhline(
        1e3 * sine_limit_rad, color=_LIMIT, lw=1, ls="--", label=f"limit of the swing, {sine_limit_rad:g} rad"
    )
    errors.set_yscale("log")
    rise.bar(x, [1e3 * row.rise_s for row in rows], width=0.7, color=colours, alpha=0.85)
    rise.axhline(1e3 * rise_limit_s, color=_LIMIT, lw=1, ls="--", label=f"limit {1e3 * rise_limit_s:g} ms")
    for axes in (errors, rise):
        axes.set_xticks(x, [f"{'LR'[j // n]}{j % n + 1}" for j in x], fontsize=8)
    swing.set_ylim(top=1.3 * swing.get_ylim()[1])
    rise.set_ylim(top=1.25e3 * rise_limit_s)
    _label(both, "Step of joint 1, both arms", "time [s]", "position [rad]")
    _label(norm, f"Error left of the step: {step.settled:.1e} rad", "time [s]", "error norm of all joints [rad]")
    _label(alone, f"A step of {abs(rows[0].step_rad):g} rad, each joint alone", "time [s]", "share of the step")
    _label(swing, f"All {robot.dof} joints swinging: RMS {1e3 * sine.rms:.2g} mrad", "time [s]", "error [mrad]")
    _label(errors, "Each joint", "joint", "error [mrad]")
    _label(rise, "Rise time of its own step, 10 % to 90 %", "joint", "time [ms]")
    _save(figure, path)


def _figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure that needs no display and no global state."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _label(axes: Any, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    axes.tick_params(labelsize=8, colors=_GREY)
    axes.grid(True, alpha=0.25, lw=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8)


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=120, metadata={"Software": None})  # no date inside: the same run writes the same bytes
