"""Figure of a training."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from minidual.policies.kinds import TrainResult
from minidual.show.figures.canvas import new_figure, save_plot


class _Line(NamedTuple):
    """A column of the loss curve that is drawn.

    Attributes:
        column: Field of a row of the curve; NaN where it was not measured.
        label: In the legend.
        colour: Of the line.
        style: Of the line.
        smoothed: Whether a moving average is drawn; the validation is not: it has few points.
    """

    column: str
    label: str
    colour: str
    style: str
    smoothed: bool = True


_LINES = (
    _Line("l1", "training, action L1", "#1f5fa8", "-"),
    _Line("keyframe", "training, keyframe L1", "#c96f1d", "--"),
    _Line("validation_l1", "held-out episodes, action L1", "#1d7f4f", "o-", smoothed=False),
)
_MARKERS = ("o", "s", "^")
_UNSMOOTHED = "#9ec5e8"
_LEARNING_RATE = "#666666"


def draw_loss(result: TrainResult, path: Path) -> None:
    """Plot losses, smoothed but for the validation, and learning rate."""
    figure, ((losses,), (rates,)) = new_figure(2, 1, 11.0, 6.6, sharex=True, height_ratios=(4, 1))
    steps = np.array([row.step for row in result.curve])
    window = 2 * max(1, len(result.curve) // 40) + 1
    losses.plot(steps, [row.l1 for row in result.curve], color=_UNSMOOTHED, linewidth=0.8)
    for line in _LINES:
        column = np.array([getattr(row, line.column) for row in result.curve], float)
        measured = ~np.isnan(column)
        if not measured.any():
            continue
        values = column[measured]
        if line.smoothed:
            values = uniform_filter1d(values, window, mode="nearest")
        losses.plot(steps[measured], values, line.style, color=line.colour, label=line.label)
    losses.set(yscale="log", ylabel="L1 [std of the actions]")
    title = (
        f"Training: {result.parameters / 1e6:.2f} M parameters, {result.steps} steps, "
        f"{result.train_s / 60:.1f} min, {result.samples_per_s:.0f} samples/s"
    )
    losses.set_title(title, loc="left", fontsize=11)
    losses.legend(frameon=False)
    rates.plot(steps, [row.learning_rate for row in result.curve], color=_LEARNING_RATE)
    rates.set(ylabel="learning rate", xlabel="step")
    save_plot(figure, path)


def draw_curve(
    rows: Sequence[Mapping[str, float]],
    labels: Mapping[str, str],
    path: Path,
) -> None:
    """Plot rates over the steps of a training.

    Args:
        rows: Each has "step" and the keys of `labels`; NaN where a rate was not measured.
        labels: {key: legend}.
        path: Of the figure.
    """
    figure, ((axes,),) = new_figure(1, 1, 9.0, 4.5)
    steps = np.array([row["step"] for row in rows])
    drawn = zip(labels.items(), _LINES, _MARKERS, strict=False)
    for (key, label), line, marker in drawn:
        values = np.array([row.get(key, math.nan) for row in rows], float)
        measured = np.isfinite(values)
        axes.plot(
            steps[measured],
            values[measured],
            f"{marker}-",
            color=line.colour,
            label=label,
            markersize=4,
        )
    axes.set(xlabel="step", ylabel="share of the episodes", ylim=(-0.03, 1.03))
    axes.legend(frameon=False)
    save_plot(figure, path)
