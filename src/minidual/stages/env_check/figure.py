"""Figure of `env-check`: the steps, the swing, their errors and the rise times."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from minidual.config.control import EnvCheckConfig
from minidual.robot.pair import Robot
from minidual.show.figures.canvas import BLUE, INK, ORANGE, limit_line, new_figure, save_plot
from minidual.stages.env_check.checks import Measurements
from minidual.stages.env_check.tracking import Tracking

_POINTS_MAX = 2000
"""Most points of a line."""
_LINE_STYLES = ("-", (0, (4, 4)))
"""Of the left and the right arm, whose lines lie on each other."""


def save_tracking(path: Path, m: Measurements, limits: EnvCheckConfig, robot: Robot) -> None:
    """Save the figure."""
    figure, ((norm, alone), (swing, rise)) = new_figure(2, 2, 11.0, 7.2)
    _draw_norm(norm, m.step, limits.step_error_max_rad)
    _draw_joints(alone, swing, m, robot)
    _draw_rise_times(rise, m, limits.rise_max_s, robot)
    for axes in (norm, alone, swing, rise):
        axes.legend(frameon=False, fontsize=8)
    save_plot(figure, path)


def _draw_norm(axes: Axes, step: Tracking, limit_rad: float) -> None:
    axes.semilogy(step.t, np.maximum(step.error_norm, 1e-16), color=INK)
    limit_line(axes, limit_rad, f"limit {limit_rad:g} rad")
    axes.set(
        title=f"Step of joint 1 of both arms leaves {step.settled:.1e} rad",
        xlabel="time [s]",
        ylabel="error of all joints [rad]",
    )


def _draw_joints(alone: Axes, swing: Axes, m: Measurements, robot: Robot) -> None:
    """Draw each joint's own step, and its error in the swing of all."""
    sine = m.sine
    every = max(1, len(sine.t) // _POINTS_MAX)
    errors_mrad = 1e3 * (sine.measured - sine.reference)[::every]
    for j in range(robot.dof):
        arm = int(robot.arm_of_joint[j])
        label = f"{robot.sides[arm]} arm" if j == robot.joints_of(arm).start else None
        colour = (BLUE, ORANGE)[arm]
        step = m.steps[j]
        alone.plot(
            step.t,
            step.share(j),
            ls=_LINE_STYLES[arm],
            color=colour,
            lw=1.0,
            label=label,
        )
        swing.plot(
            sine.t[::every],
            errors_mrad[:, j],
            alpha=0.55,
            color=colour,
            lw=1.0,
            label=label,
        )
    alone.set(
        title=f"A step of {abs(m.responses[0].step_rad):g} rad, each joint alone",
        xlabel="time [s]",
        ylabel="share of the step",
    )
    swing.set(
        title=f"All {robot.dof} joints swinging: RMS {1e3 * sine.rms:.2g} mrad",
        xlabel="time [s]",
        ylabel="error [mrad]",
    )


def _draw_rise_times(axes: Axes, m: Measurements, limit_s: float, robot: Robot) -> None:
    x = np.arange(robot.dof)
    rises_ms = [1e3 * response.rise_s for response in m.responses]
    axes.bar(x, rises_ms, width=0.7, color=robot.per_joint([BLUE, ORANGE]), alpha=0.85)
    limit_line(axes, 1e3 * limit_s, f"limit {1e3 * limit_s:g} ms")
    names = [
        f"{letter}{k + 1}" for letter, n in zip("LR", robot.dofs, strict=True) for k in range(n)
    ]
    axes.set_xticks(x, names, fontsize=8)
    axes.set(
        title="Rise time of each joint's own step, 10 % to 90 %",
        xlabel="joint",
        ylabel="time [ms]",
    )
