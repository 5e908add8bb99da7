"""Kinds of policy, named by "type" in config.json, and records of their training."""

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minidual.config.learning import TrainConfig
from minidual.durable import read_json, reading, write_csv
from minidual.errors import DataError, unknown_name
from minidual.policies.demonstrations import Demonstrations
from minidual.registry import Registry, rows_beside

Image = NDArray[np.uint8]
Advance = Callable[[int, float], None]
"""Arguments: steps since the last call, loss."""
REMEDY = "minidual train-act"


class ChunkPolicy(ABC):
    """A loaded checkpoint.

    Attributes:
        cameras: Image size (H, W) by camera.
        chunk_size: Actions per inference.
        dim: Number of joints, plus two grippers.
    """

    cameras: Mapping[str, tuple[int, int]]
    chunk_size: int
    dim: int

    def reset(self) -> None:  # noqa: B027
        """Forget what was seen: a new episode begins."""

    @abstractmethod
    def predict(self, images: Mapping[str, Image], state: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return actions (chunk_size, dim): joint targets [rad], then openings.

        `images`: (H, W, 3). `state`: (dim,), as measured.
        """


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
    """Damaged progress or that of another training, moved here."""
    stopped_by: str = "steps"
    curve: list[LossRow] = field(default_factory=list)


class Training(NamedTuple):
    """What to train a policy on; `progress` is the file of an interrupted training."""

    demos: Demonstrations
    config: TrainConfig
    seed: int
    progress: Path | None = None
    advance: Advance = lambda steps, loss: None


class PolicyKind(ABC):
    """Trains and loads policies."""

    def require(self, device: str) -> None:  # noqa: B027 (most kinds run anywhere)
        """Raise EnvironmentMissingError if `device` is unusable."""

    @abstractmethod
    def train(self, job: Training, folder: Path) -> TrainResult:
        """Train and write a new checkpoint `folder` atomically.

        On a CPU, equal inputs give equal checkpoints.

        Raises:
            DataError, UsageError: Unusable dataset, existing `folder`, or the training diverges.
            EnvironmentMissingError: Missing device.
        """

    @abstractmethod
    def load(self, folder: Path, device: str, threads: int | None) -> ChunkPolicy:
        """Load a checkpoint offline; `threads` None leaves the libraries' default.

        Raises:
            DataError: Missing or corrupt checkpoint.
            EnvironmentMissingError: Missing device.
        """


_ROWS = rows_beside(__file__)
POLICIES: Registry[PolicyKind] = Registry("policy", _ROWS["policies"], group="minidual.policies")


def load_policy(folder: Path, device: str = "cpu", threads: int | None = None) -> ChunkPolicy:
    """Load any checkpoint; raises as `PolicyKind.load`."""
    if not folder.is_dir():
        raise DataError(f"there is no checkpoint folder {folder}", remedy=REMEDY)
    with reading(f"checkpoint {folder}", f"{REMEDY} --force"):
        kind = read_json(folder / "config.json")["type"]
        if kind not in POLICIES:
            raise DataError(f"checkpoint {folder}: {unknown_name('policy', kind, POLICIES).message}")
    return POLICIES[kind].load(folder, device, threads)


def write_loss_csv(curve: Sequence[LossRow], path: Path) -> None:
    """Write the loss curve; no times, so equal seeds give equal files."""
    write_csv(path, [{n: f"{v:.6g}" if isinstance(v, float) else v for n, v in asdict(row).items()} for row in curve])


def write_train_json(result: TrainResult, extra: dict[str, Any], path: Path) -> dict[str, Any]:
    """Write and return the summary."""
    record = {key: value for key, value in asdict(result).items() if key not in ("curve", "set_aside")} | extra
    path.write_text(json.dumps(record, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return record


def draw_loss(result: TrainResult, path: Path) -> None:
    """Plot losses and learning rate."""
    from matplotlib.figure import Figure

    columns = {name: np.array([getattr(row, name) for row in result.curve], float) for name in _ROWS["losses"]}
    steps, figure = [row.step for row in result.curve], Figure(figsize=(9.0, 5.4), dpi=140, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(4, 1))
    above.plot(steps, columns["l1"], color="#9ec5e8", linewidth=0.8)
    for name, (label, colour, style) in _ROWS["losses"].items():
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
