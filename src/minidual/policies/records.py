"""Results of training."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minidual import durable


@dataclass(frozen=True)
class LossRow:
    """Means since the last row, and validation if it was due."""

    step: int
    loss: float
    l1: float
    keyframe: float | None
    learning_rate: float
    validation_l1: float | None = None
    validation_keyframe_rad: float | None = None


@dataclass
class TrainResult:
    """A training summary; L1 in units of the action's std."""

    steps: int
    steps_asked: int
    train_s: float
    samples_per_s: float
    parameters: int
    loss_initial: float
    loss_final: float
    loss_ratio: float
    training_episodes: list[int]
    validation_episodes: list[int]
    ticks: int
    validation_l1: float | None = None
    validation_keyframe_rad: float | None = None
    bf16: bool = False
    resumed_from_step: int = 0
    set_aside: Path | None = None
    """Damaged progress, moved here."""
    stopped_by: str = "steps"
    curve: list[LossRow] = field(default_factory=list)


LOSSES = {
    "l1": ("training, action L1", "#1f5fa8", "-"),
    "keyframe": ("training, keyframe L1", "#c96f1d", "-"),
    "validation_l1": ("held-out episodes, action L1", "#1d7f4f", "o-"),
}
"""Columns drawn: label, colour, style."""


def write_loss_csv(curve: Sequence[LossRow], path: Path) -> None:
    """Write the loss curve; no times, so equal seeds give equal files."""
    rows = [{n: f"{v:.6g}" if isinstance(v, float) else v for n, v in asdict(row).items()} for row in curve]
    durable.write_csv(path, rows)


def write_train_json(result: TrainResult, extra: dict[str, Any], path: Path) -> dict[str, Any]:
    """Write and return the summary."""
    record = {key: value for key, value in asdict(result).items() if key not in ("curve", "set_aside")} | extra
    path.write_text(json.dumps(record, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return record


def draw_loss(result: TrainResult, path: Path) -> None:
    """Plot losses and learning rate."""
    from matplotlib.figure import Figure

    columns = {name: np.array([getattr(row, name) for row in result.curve], float) for name in LOSSES}
    steps = [row.step for row in result.curve]
    figure = Figure(figsize=(9.0, 5.4), dpi=140, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(4, 1))
    above.plot(steps, columns["l1"], color="#9ec5e8", linewidth=0.8)
    for name, (label, colour, style) in LOSSES.items():
        known = ~np.isnan(columns[name])
        if known.any():
            values = columns[name][known] if "validation" in name else _smooth(columns[name][known])
            above.plot(np.array(steps)[known], values, style, color=colour, label=label)
    above.set(yscale="log", ylabel="L1 [std of the actions]")
    title = f"Training: {result.parameters / 1e6:.2f} M parameters, {result.steps} steps, {result.train_s / 60:.1f} min"
    above.set_title(f"{title}, {result.samples_per_s:.0f} samples/s", loc="left", fontsize=11)
    above.legend(frameon=False)
    below.plot(steps, [row.learning_rate for row in result.curve], color="#666666")
    below.set(ylabel="learning rate", xlabel="step")
    for axes in (above, below):
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)


def _smooth(values: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.ndimage import uniform_filter1d

    return uniform_filter1d(values, 2 * max(1, len(values) // 40) + 1, mode="nearest")
