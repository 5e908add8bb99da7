"""Figure of a recording."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from minidual.demos.episode import read_episode
from minidual.demos.rig import Attempt
from minidual.show.figures.canvas import BLUE, LIMIT, new_figure
from minidual.tasks.task import Trial, placement


def draw_quality(
    attempts: Sequence[Attempt],
    tested: Sequence[Trial],
    jerk_limit_rad_s3: float,
    path: Path,
) -> None:
    """Draw starts of attempts and tests, RMS jerk, and targets of the first demonstration."""
    figure, ((starts, jerks, motion),) = new_figure(1, 3, 13, 3.8)
    for kept, colour, label in ((True, BLUE, "kept"), (False, LIMIT, "rejected")):
        if chosen := [_start(a.trial) for a in attempts if a.kept is kept]:
            x, y, yaw = np.array(chosen).T
            line = {
                "headwidth": 0,
                "headlength": 0,
                "headaxislength": 0,
                "width": 0.004,
                "scale": 18,
                "pivot": "mid",
            }
            starts.quiver(
                y,
                x,
                -np.cos(yaw),
                np.sin(yaw),
                color=colour,
                label=f"{label} ({len(chosen)})",
                **line,
            )
            starts.update_datalim(np.column_stack([y, x]))  # quiver does not
    x, y, _ = np.array([_start(trial) for trial in tested]).T
    starts.plot(y, x, ".", color="0.6", ms=2, zorder=0, label="tests")
    starts.set(
        title=f"{next(iter(tested[0].start))} at the start",
        xlabel="y [m]",
        ylabel="x [m]",
        ymargin=0.15,
    )
    starts.axis("equal")
    starts.invert_xaxis()
    starts.legend(fontsize=7, loc="upper center", ncols=3)

    jerks.hist(
        [a.quality.rms_jerk_rad_s3 for a in attempts if a.quality is not None],
        bins=20,
        color=BLUE,
    )
    jerks.locator_params(axis="y", integer=True)
    jerks.set(
        title=f"RMS jerk (limit {jerk_limit_rad_s3:.0f} rad/s³)",
        xlabel="rad/s³",
        ylabel="episodes",
    )

    index, recorded = next(
        (a.trial.index, a.path) for a in attempts if a.kept and a.path is not None
    )
    episode = read_episode(recorded, cameras=())
    t = episode.timestamps - episode.timestamps[0]
    per_arm = episode.qpos.shape[1] // 2
    for k, joint in enumerate(dict.fromkeys((0, 1, per_arm // 2, per_arm - 1))):
        motion.plot(t, episode.action[:, joint], color=f"C{k}", lw=0.9, ls="--")
        motion.plot(
            t,
            episode.qpos[:, joint],
            color=f"C{k}",
            lw=1.2,
            label=f"left joint {joint + 1}",
        )
    motion.set(
        title=f"Trial {index}: measured (full), commanded (dashed)",
        xlabel="t [s]",
        ylabel="rad",
    )
    motion.legend(fontsize=7)
    figure.savefig(path)


def _start(trial: Trial) -> tuple[float, float, float]:
    return placement(next(iter(trial.start.values())))
