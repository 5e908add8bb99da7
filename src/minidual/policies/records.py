"""Results of training."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class LossRow:
    """Means since the last row, and any validation."""

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
    stopped_by: str = "steps"
    curve: list[LossRow] = field(default_factory=list)


def write_loss_csv(curve: Sequence[LossRow], path: Path) -> None:
    """Write the loss curve, without times: equal seeds, equal files."""
    with path.open("w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle, lineterminator="\n")
        names = [f.name for f in fields(LossRow)]
        writer.writerow(names)
        for row in curve:
            values = (getattr(row, name) for name in names)
            writer.writerow(["" if v is None else v if isinstance(v, int) else f"{v:.6g}" for v in values])


def write_train_json(result: TrainResult, extra: dict[str, Any], path: Path) -> dict[str, Any]:
    """Write and return the summary."""
    record = {key: value for key, value in asdict(result).items() if key != "curve"} | extra
    path.write_text(json.dumps(record, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return record


def draw_loss(result: TrainResult, path: Path) -> None:
    """Plot losses and learning rate."""
    from matplotlib.figure import Figure

    curve = result.curve
    steps = np.array([row.step for row in curve])
    l1 = np.array([row.l1 for row in curve])
    figure = Figure(figsize=(9.0, 5.4), dpi=140, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(4, 1))
    above.plot(steps, l1, color="#9ec5e8", linewidth=0.8)
    above.plot(steps, _smooth(l1), color="#1f5fa8", linewidth=2.0, label="training, action L1")
    keyframes = [(row.step, row.keyframe) for row in curve if row.keyframe is not None]
    if keyframes:
        x, y = np.array(keyframes).T
        above.plot(x, _smooth(y), color="#c96f1d", linewidth=1.4, label="training, keyframe L1")
    validated = [(row.step, row.validation_l1) for row in curve if row.validation_l1 is not None]
    if validated:
        x, y = np.array(validated).T
        above.plot(x, y, "o-", color="#1d7f4f", markersize=4, linewidth=1.0, label="held-out episodes, action L1")
    above.set_yscale("log")
    above.set_ylabel("L1 [std of the actions]")
    above.set_title(
        f"Training: {result.parameters / 1e6:.2f} M parameters, {result.steps} steps, "
        f"{result.train_s / 60:.1f} min, {result.samples_per_s:.0f} samples/s",
        loc="left",
        fontsize=11,
    )
    above.legend(frameon=False)
    below.plot(steps, [row.learning_rate for row in curve], color="#666666", linewidth=1.2)
    below.set_ylabel("learning rate")
    below.set_xlabel("step")
    for axes in (above, below):
        axes.grid(alpha=0.25, which="both" if axes is above else "major")
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)


def _smooth(values: np.ndarray) -> np.ndarray:
    """Moving mean over a twentieth of the points."""
    half = max(1, len(values) // 40)
    sums = np.concatenate([[0.0], np.cumsum(values)])
    index = np.arange(len(values))
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, len(values))
    return (sums[high] - sums[low]) / (high - low)
