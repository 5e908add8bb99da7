"""Figure of one trial."""

import textwrap
from pathlib import Path

import numpy as np

from minidual.config.scene import SceneConfig
from minidual.robot.pair import Array, Robot
from minidual.show.figures.canvas import BLUE, GREEN, INK, ORANGE, limit_line, new_figure
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
    task = scene.task
    for k, (name, colour) in enumerate((("x", BLUE), ("y", ORANGE), ("z", GREEN))):
        motion.plot(log.t, log.position[:, k], color=colour, label=name)
        motion.axhline(goal[k], color=colour, lw=0.8, ls=":")
    if task.obstacle is not None:
        limit_line(motion, task.obstacle.size_m[2], "top of the obstacle")
    motion.set(title="Position of the object (dotted: goal)", ylabel="m")

    tilt.plot(log.t, np.degrees(log.tilt), color=INK)
    limit_line(tilt, float(np.degrees(task.tilt_max_rad)))
    tilt.set(title="Tilt of the object", ylabel="deg", ylim=(0, None))

    force.plot(log.t, log.pinch[:, 0], color=BLUE, label="pinch, left hand")
    force.plot(log.t, log.pinch[:, 1], color=ORANGE, ls="--", label="pinch, right hand")
    force.plot(log.t, log.internal_force, color=INK, label="internal force")
    limit_line(force, task.pinch_min_n, "least allowed in the air")
    if task.internal_force_min_n != task.pinch_min_n:
        limit_line(force, task.internal_force_min_n, "least squeeze allowed in the air", ":")
    if scene.object.break_force_n is not None:
        limit_line(force, scene.object.break_force_n, "force of a hand that breaks it", "-.")
    force.set(title="Forces on the object", ylabel="N", xlabel="s")

    left, right = np.split(np.abs(log.tau) / robot.tau_max, 2, axis=1)
    for joint, ratio in enumerate(np.maximum(left, right).T, start=1):
        torque.plot(log.t, ratio, lw=1, label=f"joint {joint}")
    limit_line(torque, 1.0, None)
    torque.set(title="Motor torque / limit, larger of both arms", xlabel="s", ylim=(0, 1.25))
    for axis, columns in ((motion, 2), (tilt, 1), (force, 1), (torque, 4)):
        axis.legend(ncols=columns, frameon=False, fontsize=8)
    figure.suptitle("\n".join(textwrap.wrap(title, 110)), fontsize=12)
    figure.savefig(path)
