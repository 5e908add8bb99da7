"""Figure of a recording."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from minidual.demos.episode import read_episode
from minidual.demos.rig import Attempt
from minidual.robot.pair import Array
from minidual.show.figures.canvas import BLUE, GREEN, INK, LIMIT, ORANGE, new_figure, save_plot
from minidual.tasks.task import Trial, placement

_MARKERS = ("o", "s", "^", "D")


def draw_quality(
    attempts: Sequence[Attempt],
    tested: Sequence[Trial],
    jerk_limit_rad_s3: float,
    path: Path,
) -> None:
    """Draw starts of attempts and tests, RMS jerk, and targets of the first demonstration.

    Args:
        attempts: Recorded demonstrations; at least one was kept.
        tested: Trials on which a policy will be tested; at least one.
        jerk_limit_rad_s3: Limit of the RMS jerk.
        path: Of the figure.
    """
    figure, ((starts, jerks, motion),) = new_figure(1, 3, 13, 3.8)
    _draw_starts(starts, attempts, tested)
    _draw_jerks(jerks, attempts, jerk_limit_rad_s3)
    _draw_motion(motion, attempts)
    save_plot(figure, path)


def draw_lags(lags_s: Array, limit_s: float, path: Path) -> None:
    """Draw a histogram of the joints' lags (m,) [s] behind the leader."""
    figure, ((axis,),) = new_figure(1, 1, 5.5, 3.2)
    axis.hist(1e3 * lags_s, bins=np.arange(0.0, 305.0, 5.0), color=BLUE)
    for percent, style in ((50, "-"), (99, "--")):
        if len(lags_s):
            lag_ms = 1e3 * float(np.percentile(lags_s, percent))
            label = f"{percent} %: {lag_ms:.0f} ms"
            axis.axvline(lag_ms, color=ORANGE, lw=1.2, ls=style, label=label)
    axis.axvline(1e3 * limit_s, color=LIMIT, lw=1, ls=":", label="limit of the median")
    axis.set(title="Joints behind the leader", xlabel="ms", ylabel="moving samples")
    axis.legend(fontsize=7)
    save_plot(figure, path)


def _draw_starts(axis: Any, attempts: Sequence[Attempt], tested: Sequence[Trial]) -> None:
    """Draw where the first object stands at the start, from above."""
    for kept, colour, label in ((True, BLUE, "kept"), (False, LIMIT, "rejected")):
        placements = [_start(attempt.trial) for attempt in attempts if attempt.kept is kept]
        if not placements:
            continue
        x, y, yaw = np.array(placements).T
        axis.quiver(
            y,
            x,
            -np.cos(yaw),
            np.sin(yaw),
            color=colour,
            label=f"{label} ({len(placements)})",
            headwidth=0,
            headlength=0,
            headaxislength=0,
            width=0.004,
            scale=18,
            pivot="mid",
        )
        axis.update_datalim(np.column_stack([y, x]))  # quiver does not
    x, y, _ = np.array([_start(trial) for trial in tested]).T
    axis.plot(y, x, ".", color="0.6", ms=2, zorder=0, label="tests")
    first_object = next(iter(tested[0].start))
    axis.set(title=f"{first_object} at the start", xlabel="y [m]", ylabel="x [m]", ymargin=0.15)
    axis.axis("equal")
    axis.invert_xaxis()
    axis.legend(fontsize=7, loc="upper center", ncols=3)


def _start(trial: Trial) -> tuple[float, float, float]:
    """Return x [m], y [m] and yaw [rad] of the first object at the start."""
    return placement(next(iter(trial.start.values())))


def _draw_jerks(axis: Any, attempts: Sequence[Attempt], limit_rad_s3: float) -> None:
    jerks = [attempt.quality.rms_jerk_rad_s3 for attempt in attempts if attempt.quality is not None]
    axis.hist(jerks, bins=20, color=BLUE)
    axis.locator_params(axis="y", integer=True)
    axis.set(
        title=f"RMS jerk (limit {limit_rad_s3:.0f} rad/s³)",
        xlabel="rad/s³",
        ylabel="episodes",
    )


def _draw_motion(axis: Any, attempts: Sequence[Attempt]) -> None:
    """Draw measured and commanded joints of the first demonstration that was kept."""
    index, recording = next(
        (attempt.trial.index, attempt.path)
        for attempt in attempts
        if attempt.kept and attempt.path is not None
    )
    episode = read_episode(recording, cameras=())
    t = episode.timestamps - episode.timestamps[0]
    joints_per_arm = episode.qpos.shape[1] // 2
    shown_joints = dict.fromkeys((0, 1, joints_per_arm // 2, joints_per_arm - 1))
    colours = (BLUE, ORANGE, GREEN, INK)
    for k, joint in enumerate(shown_joints):
        colour = colours[k % len(colours)]
        axis.plot(t, episode.action[:, joint], color=colour, lw=0.9, ls="--")
        axis.plot(
            t,
            episode.qpos[:, joint],
            color=colour,
            lw=1.2,
            ls="-",
            marker=_MARKERS[k % len(_MARKERS)],
            markevery=max(1, len(t) // 8),
            ms=4,
            label=f"left joint {joint + 1}",
        )
    axis.set(
        title=f"Trial {index}: measured (full), commanded (dashed)",
        xlabel="t [s]",
        ylabel="rad",
    )
    axis.legend(fontsize=7)
