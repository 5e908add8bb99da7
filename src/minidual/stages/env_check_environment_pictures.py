"""What the cameras see, and the pictures of the environment check: film of the swing, cameras, tracking."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from minidual.plant.model import CAMERAS
from minidual.plant.render import Camera, Image, write_video
from minidual.plant.world import World
from minidual.robot.constants import ARMS, DOF_PER_ARM, Array
from minidual.stages.env_check_joint_response import JointResponse
from minidual.stages.env_check_joint_tracking import Tracking

_LEFT, _RIGHT, _GREY, _LIMIT = "#1f5fa8", "#d1661b", "#5b6670", "#b3261e"


@dataclass(frozen=True)
class CameraCheck:
    """What the pictures hold, as shares of a picture (0..1) unless said otherwise.

    Attributes:
        contrast_min: Least standard deviation of brightness (0..255) among the cameras; 0 is one flat colour.
        rod_share: Orange pixels in `high`.
        fingers_min: Least share of a fingertip in the camera of its own wrist, over four fingers.
        gl_renderer: Name of the OpenGL renderer, for the bill of versions.
    """

    contrast_min: float
    rod_share: float
    fingers_min: float
    gl_renderer: str


def orange_share(image: Image) -> float:
    """Return the share of pixels (0..1) of an (H, W, 3) picture that have the rod's orange."""
    r, g, b = (image[..., c].astype(int) for c in range(3))
    return float(np.mean((r > 140) & (r - b > 90) & (r - g > 40) & (g - b > 15)))


def check_cameras(world: World, *, width_px: int = 320, height_px: int = 240) -> CameraCheck:
    """Render the recorded cameras of a world compiled with visuals, as it stands.

    Raises:
        EnvironmentMissingError: No off-screen OpenGL context can be made.
    """
    with Camera(world.model, width_px, height_px) as camera:
        pictures = {name: camera.picture(world.data, name) for name in CAMERAS}
        fingers = [
            camera.bodies_seen(world.data, arm).get(f"{arm}_panda_{finger}", 0.0)
            for arm in ARMS
            for finger in ("leftfinger", "rightfinger")
        ]
        renderer = _gl_renderer()
    contrast = min(float(picture.mean(axis=2).std()) for picture in pictures.values())
    return CameraCheck(contrast, orange_share(pictures["high"]), min(fingers), renderer)


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
    from OpenGL import GL

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
    path: Path, step: Tracking, sine: Tracking, alone: Array, *, step_limit_rad: float, sine_limit_rad: float
) -> None:
    """Save the step response, the swing and the errors of each joint as one figure.

    Args:
        path: PNG to write.
        step: Step of joint 1 of both arms.
        sine: Swing of all joints.
        alone: Error left after each joint's own step (14,) [rad].
        step_limit_rad: Limit on the error after the step.
        sine_limit_rad: Limit on the RMS of the swing.
    """
    figure = _figure(11.0, 7.2)
    _draw_step(figure.add_subplot(2, 2, 1), step)
    _draw_error_norm(figure.add_subplot(2, 2, 2), step, step_limit_rad)
    _draw_swing(figure.add_subplot(2, 2, 3), sine)
    _draw_joints(figure.add_subplot(2, 2, 4), sine.joint_rms, alone, sine_limit_rad)
    _save(figure, path)


def save_joints(path: Path, steps: Sequence[Tracking], rows: Sequence[JointResponse], *, rise_limit_s: float) -> None:
    """Save how each joint answers its own step: the responses on one scale, and the rise times.

    Args:
        path: PNG to write.
        steps: The step of each joint alone.
        rows: Numbers of the same, with the swing's.
        rise_limit_s: Limit on the rise time.
    """
    figure = _figure(11.0, 4.2)
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    for j, (step, row) in enumerate(zip(steps, rows, strict=True)):
        arm = j // DOF_PER_ARM
        label = f"{ARMS[arm]} arm" if j % DOF_PER_ARM == 0 else None
        share = (step.measured[:, j] - step.start[j]) / row.step_rad
        style = {"color": (_LEFT, _RIGHT)[arm], "ls": ("-", (0, (4, 4)))[arm]}  # the arms answer alike
        left.plot(step.t, share, lw=1.3, label=label, **style)
    left.axhline(1.0, color=_GREY, lw=0.8, ls=":")
    _label(left, f"A step of {abs(rows[0].step_rad):g} rad, each joint alone", "time [s]", "share of the step")
    left.legend(frameon=False, fontsize=8, loc="lower right")
    x = np.arange(len(rows))
    colours = [_LEFT] * DOF_PER_ARM + [_RIGHT] * DOF_PER_ARM
    right.bar(x, [1e3 * row.rise_s for row in rows], width=0.7, color=colours, alpha=0.85)
    right.axhline(1e3 * rise_limit_s, color=_LIMIT, lw=1, ls="--", label=f"limit {1e3 * rise_limit_s:g} ms")
    right.set_xticks(x, [f"{'LR'[i // DOF_PER_ARM]}{i % DOF_PER_ARM + 1}" for i in x], fontsize=8)
    right.set_ylim(top=1.25e3 * rise_limit_s)
    _label(right, "Rise time, 10 % to 90 %", "joint", "time [ms]")
    right.legend(frameon=False, fontsize=8, loc="upper right")
    _save(figure, path)


def _draw_step(axes: Any, step: Tracking) -> None:
    for joint, colour, label in ((0, _LEFT, "left joint 1"), (DOF_PER_ARM, _RIGHT, "right joint 1")):
        axes.plot(step.t, step.reference[:, joint], color=colour, lw=1, ls="--", alpha=0.6)
        axes.plot(step.t, step.measured[:, joint], color=colour, lw=1.8, label=label)
    _label(axes, "Step of joint 1, both arms", "time [s]", "position [rad]")
    axes.legend(frameon=False, fontsize=8, loc="center right")


def _draw_error_norm(axes: Any, step: Tracking, limit_rad: float) -> None:
    axes.semilogy(step.t, np.maximum(step.error_norm, 1e-16), color=_GREY, lw=1.6)
    axes.axhline(limit_rad, color=_LIMIT, lw=1, ls="--")
    axes.annotate(
        f"limit {limit_rad:g} rad",
        (step.t[-1], limit_rad),
        ha="right",
        xytext=(0, 3),
        textcoords="offset points",
        color=_LIMIT,
        fontsize=8,
    )
    _label(axes, f"Error left of the step: {step.settled:.1e} rad", "time [s]", "14-D error norm [rad]")


def _draw_swing(axes: Any, sine: Tracking) -> None:
    every = max(1, len(sine.t) // 2000)
    error = 1e3 * (sine.measured - sine.reference)[::every]
    for arm, colour in enumerate((_LEFT, _RIGHT)):
        for joint in range(DOF_PER_ARM):
            label = f"{ARMS[arm]} arm" if joint == 0 else None
            column = arm * DOF_PER_ARM + joint
            axes.plot(sine.t[::every], error[:, column], color=colour, lw=0.9, alpha=0.55, label=label)
    _label(axes, f"All 14 joints swinging: RMS {1e3 * sine.rms:.2g} mrad", "time [s]", "error [mrad]")
    axes.set_ylim(top=1.3 * axes.get_ylim()[1])
    axes.legend(frameon=False, fontsize=8, loc="upper right", ncols=2)


def _draw_joints(axes: Any, swing: Array, alone: Array, limit_rad: float) -> None:
    x = np.arange(len(swing))
    colours = [_LEFT] * DOF_PER_ARM + [_RIGHT] * DOF_PER_ARM
    axes.bar(x - 0.2, 1e3 * swing, width=0.38, color=colours, label="RMS while all swing")
    axes.bar(x + 0.2, 1e3 * alone, width=0.38, color=colours, alpha=0.4, label="left after its own step")
    axes.axhline(1e3 * limit_rad, color=_LIMIT, lw=1, ls="--", label=f"limit of the swing, {limit_rad:g} rad")
    axes.set_yscale("log")
    axes.set_xticks(x, [f"{'LR'[i // DOF_PER_ARM]}{i % DOF_PER_ARM + 1}" for i in x], fontsize=8)
    _label(axes, "Each joint", "joint", "error [mrad]")
    axes.legend(frameon=False, fontsize=8, loc="center right", bbox_to_anchor=(1.0, 0.72))


def _figure(width_in: float, height_in: float) -> Any:
    """Return an empty figure that needs no display and no global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _label(axes: Any, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    axes.tick_params(labelsize=8, colors=_GREY)
    axes.grid(True, alpha=0.25, lw=0.6)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _save(figure: Any, path: Path) -> None:
    # No date inside: the same run writes the same bytes.
    figure.savefig(path, dpi=120, metadata={"Software": None})
