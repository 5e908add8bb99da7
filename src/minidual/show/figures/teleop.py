"""The figure that shows what was recorded: starts, smoothness, and one episode's targets against its joints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from minidual.config.scene import TaskConfig
from minidual.demos.episode import read_episode
from minidual.demos.rig import Attempt
from minidual.tasks.rod_carry import placement


def draw_quality(attempts: Sequence[Attempt], task: TaskConfig, jerk_limit_rad_s3: float, path: Path) -> None:
    """Write a png of the recording: start poses, RMS jerk, and the targets and joints of the first demonstration."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    starts, jerks, motion = figure.subplots(1, 3)

    for kept, colour, label in ((True, "#2a6fb0", "kept"), (False, "#d1495b", "rejected")):
        chosen = [placement(next(iter(a.trial.start.values()))) for a in attempts if a.kept is kept]
        if chosen:
            x, y, yaw = np.array(chosen).T
            starts.quiver(
                y,
                x,
                -np.cos(yaw),
                np.sin(yaw),
                color=colour,
                label=f"{label} ({len(chosen)})",
                pivot="mid",
                width=0.004,
                headwidth=0,
                headlength=0,
                headaxislength=0,
                scale=18,
            )
    r = task.start_range_m
    (cx, cy) = task.start_xy_m
    starts.plot(
        cy + r * np.array([-1, 1, 1, -1, -1]),
        cx + r * np.array([-1, -1, 1, 1, -1]),
        "k--",
        lw=0.8,
        label="tested range",
    )
    reach = 1.6 * max(r, 0.02)
    starts.set(
        title="Rod at the start",
        xlabel="y [m]",
        ylabel="x [m]",
        aspect="equal",
        xlim=(cy + reach, cy - reach),
        ylim=(cx - reach, cx + reach),
    )
    starts.legend(fontsize=7, loc="upper right")

    values = [a.quality.rms_jerk_rad_s3 for a in attempts if a.quality is not None]
    jerks.hist(values, bins=20, color="#2a6fb0")
    jerks.set(title=f"RMS jerk (limit {jerk_limit_rad_s3:.0f} rad/s³)", xlabel="rad/s³", ylabel="episodes")

    shown = next((a for a in attempts if a.kept and a.path is not None), None)
    if shown is not None and shown.path is not None:
        episode = read_episode(shown.path, cameras=())
        t = episode.timestamps - episode.timestamps[0]
        for joint, colour in ((0, "C0"), (1, "C1"), (3, "C2"), (6, "C3")):
            motion.plot(t, episode.action[:, joint], color=colour, lw=0.9, ls="--")
            motion.plot(t, episode.qpos[:, joint], color=colour, lw=1.2, label=f"left joint {joint + 1}")
        motion.set(
            title=f"Trial {shown.trial.index}: measured (full), commanded (dashed)", xlabel="t [s]", ylabel="rad"
        )
        motion.legend(fontsize=7)
    figure.savefig(path, dpi=110)
