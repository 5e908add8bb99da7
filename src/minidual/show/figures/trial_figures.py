"""Figures of single trials: what the rod, the forces and the motors did over time."""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np

from minidual.config.scene import SceneConfig
from minidual.robot.pair import Robot
from minidual.trials.trials import TrialLog

_INK, _LIMIT = "#1f3b57", "#c0392b"


def draw_trial(log: TrialLog, scene: SceneConfig, robot: Robot, path: Path, *, title: str) -> None:
    """Write a four-panel figure of one trial: rod path, tilt, forces and torque ratios."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(11, 6.4), sharex=True, constrained_layout=True)
    (motion, tilt), (force, torque) = axes
    goal = np.array([*scene.task.goal_xy_m, scene.rod.rest_height_m])
    for k, (name, colour) in enumerate((("x", "#2f6db5"), ("y", "#e07b27"), ("z", "#3a9a5b"))):
        motion.plot(log.t, log.rod[:, k], color=colour, label=name)
        motion.axhline(goal[k], color=colour, lw=0.8, ls=":")
    obstacle = scene.task.obstacle
    if obstacle is not None:
        motion.axhline(obstacle.size_m[2], color=_LIMIT, lw=1, ls="--", label="top of the obstacle")
    motion.set(title="Position of the object (dotted: goal)", ylabel="m")
    motion.legend(ncols=2, frameon=False, fontsize=8)

    tilt.plot(log.t, np.degrees(log.tilt), color=_INK)
    tilt.axhline(np.degrees(scene.task.tilt_max_rad), color=_LIMIT, lw=1, ls="--", label="limit")
    tilt.set(title="Tilt of the object", ylabel="deg", ylim=(0, None))
    tilt.legend(frameon=False)

    force.plot(log.t, log.pinch[:, 0], color="#2f6db5", label="pinch, left hand")
    force.plot(log.t, log.pinch[:, 1], color="#e07b27", ls="--", label="pinch, right hand")
    force.plot(log.t, log.internal_force, color=_INK, label="internal force")
    least_pinch, least_squeeze = scene.task.pinch_min_n, scene.task.internal_force_min_n
    force.axhline(least_pinch, color=_LIMIT, lw=1, ls="--", label="least allowed in the air")
    if least_squeeze != least_pinch:
        force.axhline(least_squeeze, color=_LIMIT, lw=1, ls=":", label="least squeeze allowed in the air")
    strongest = scene.rod.break_force_n
    if strongest is not None:
        force.axhline(strongest, color=_LIMIT, lw=1, ls="-.", label="a hand's force that breaks it")
    force.set(title="Forces on the object", ylabel="N", xlabel="s")
    force.legend(frameon=False, fontsize=8)

    left, right = np.split(np.abs(log.tau) / robot.tau_max, 2, axis=1)
    for joint, ratio in enumerate(np.maximum(left, right).T, start=1):
        torque.plot(log.t, ratio, lw=1, label=f"joint {joint}")
    torque.axhline(1.0, color=_LIMIT, lw=1, ls="--")
    torque.set(title="Motor torque / limit, larger of both arms", xlabel="s", ylim=(0, 1.25))
    torque.legend(ncols=4, frameon=False, fontsize=8)
    for axis in axes.flat:
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    figure.suptitle("\n".join(textwrap.wrap(title, 110)), fontsize=12)
    figure.savefig(path, dpi=110)
    plt.close(figure)
