"""Figure of a training."""

from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d

from minidual.policies.kinds import TrainResult
from minidual.registry import rows_beside
from minidual.show.figures.canvas import new_figure

_LINES = rows_beside(__file__)


def draw_loss(result: TrainResult, path: Path) -> None:
    """Plot losses, smoothed but for the validation, and learning rate."""
    figure, ((above,), (below,)) = new_figure(2, 1, 11.0, 6.6, sharex=True, height_ratios=(4, 1))
    columns = {
        name: np.array([getattr(row, name) for row in result.curve], float) for name in _LINES
    }
    steps = np.array([row.step for row in result.curve])
    span = 2 * max(1, len(result.curve) // 40) + 1
    above.plot(steps, columns["l1"], color="#9ec5e8", linewidth=0.8)
    for name, (label, colour, style) in _LINES.items():
        known = ~np.isnan(columns[name])
        if known.any():
            found = columns[name][known]
            values = (
                found if "validation" in name else uniform_filter1d(found, span, mode="nearest")
            )
            above.plot(steps[known], values, style, color=colour, label=label)
    above.set(yscale="log", ylabel="L1 [std of the actions]")
    title = f"Training: {result.parameters / 1e6:.2f} M parameters, {result.steps} steps, {result.train_s / 60:.1f} min"
    above.set_title(f"{title}, {result.samples_per_s:.0f} samples/s", loc="left", fontsize=11)
    above.legend(frameon=False)
    below.plot(steps, [row.learning_rate for row in result.curve], color="#666666")
    below.set(ylabel="learning rate", xlabel="step")
    figure.savefig(path)
