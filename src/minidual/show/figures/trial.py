"""Figure of one trial."""

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from minidual.config.scene import SceneConfig
from minidual.robot.pair import Array, Robot
from minidual.show.figures.canvas import (
    BLUE,
    GREEN,
    INK,
    LINES,
    ORANGE,
    limit_line,
    new_figure,
    save_plot,
)
from minidual.trials.measures import TrialLog


def draw_trial(
    log: TrialLog,
    scene: SceneConfig,
    robot: Robot,
    path: Path,
    *,
    goal: Array,
    title: str,
) -> None:
    """Draw object pose, its goal (3,) [m], forces, and torque ratios."""
    figure, ((motion, tilt), (force, torque)) = new_figure(2, 2, 11, 6.4, sharex=True)
    _draw_motion(motion, log, scene, goal)
    _draw_tilt(tilt, log, scene)
    _draw_forces(force, log, scene)
    _draw_torques(torque, log, robot)
    for axis, columns in ((motion, 2), (tilt, 1), (force, 1), (torque, 4)):
        axis.legend(ncols=columns, frameon=False, fontsize=8)
    figure.suptitle("\n".join(textwrap.wrap(title, 110)), fontsize=12)
    save_plot(figure, path)


def _draw_motion(axis: Any, log: TrialLog, scene: SceneConfig, goal: Array) -> None:
    looks = (("x", BLUE, "-"), ("y", ORANGE, "--"), ("z", GREEN, "-."))
    for k, (name, colour, style) in enumerate(looks):
        axis.plot(log.t, log.position[:, k], color=colour, ls=style, label=name)
        axis.axhline(goal[k], color=colour, lw=0.8, ls=":")
    obstacle = scene.task.obstacle
    if obstacle is not None:
        limit_line(axis, obstacle.size_m[2], "top of the obstacle")
    axis.set(title="Position of the object (dotted: goal)", ylabel="m")


def _draw_tilt(axis: Any, log: TrialLog, scene: SceneConfig) -> None:
    axis.plot(log.t, np.degrees(log.tilt), color=INK)
    limit_line(axis, float(np.degrees(scene.task.tilt_max_rad)))
    axis.set(title="Tilt of the object", ylabel="deg", ylim=(0, None))


def _draw_forces(axis: Any, log: TrialLog, scene: SceneConfig) -> None:
    task = scene.task
    axis.plot(log.t, log.pinch[:, 0], color=BLUE, label="pinch, left hand")
    axis.plot(log.t, log.pinch[:, 1], color=ORANGE, ls="--", label="pinch, right hand")
    axis.plot(log.t, log.internal_force, color=INK, lw=2, label="internal force")
    limit_line(axis, task.pinch_min_n, "least allowed in the air")
    if task.internal_force_min_n != task.pinch_min_n:
        limit_line(axis, task.internal_force_min_n, "least squeeze allowed in the air", ":")
    if scene.object.break_force_n is not None:
        limit_line(axis, scene.object.break_force_n, "force of a hand that breaks it", "-.")
    axis.set(title="Forces on the object", ylabel="N", xlabel="s")


def _draw_torques(axis: Any, log: TrialLog, robot: Robot) -> None:
    larger = np.zeros((len(log.t), robot.dof_most))
    for of_arm in robot.by_arm(np.abs(log.tau) / robot.tau_max):
        own = larger[:, : of_arm.shape[1]]
        np.maximum(own, of_arm, out=own)
    for joint, ratio in enumerate(larger.T, start=1):
        colour, style = LINES[(joint - 1) % len(LINES)]
        axis.plot(log.t, ratio, lw=1, color=colour, ls=style, label=f"joint {joint}")
    limit_line(axis, 1.0, None)
    axis.set(title="Motor torque / limit, larger of both arms", xlabel="s", ylim=(0, 1.25))
