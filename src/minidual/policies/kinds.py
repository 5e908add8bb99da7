"""Kinds of policy, named by "type" in config.json."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from minidual.config.learning import TrainConfig
from minidual.durable import read_json, reading
from minidual.errors import DataError, unknown_name
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.records import TrainResult
from minidual.registry import Registry

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

    @abstractmethod
    def predict(self, images: Mapping[str, Image], state: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return actions (chunk_size, dim): joint targets [rad], then openings.

        `images`: (H, W, 3). `state`: (dim,), as measured.
        """


@dataclass(frozen=True)
class Training:
    """What to train a policy on; `resume_dir` keeps an interrupted training."""

    demos: Demonstrations
    config: TrainConfig
    seed: int
    resume_dir: Path | None = None
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


POLICIES: Registry[PolicyKind] = Registry(
    "policy",
    {"spatial_act": "minidual.policies.act:SPATIAL_ACT", "act": "minidual.policies.act:ACT_KIND"},
    group="minidual.policies",
)


def load_policy(folder: Path, device: str = "cpu", threads: int | None = None) -> ChunkPolicy:
    """Load any checkpoint; raises as `PolicyKind.load`."""
    if not folder.is_dir():
        raise DataError(f"there is no checkpoint folder {folder}", remedy=REMEDY)
    with reading(f"checkpoint {folder}", f"{REMEDY} --force"):
        kind = read_json(folder / "config.json")["type"]
        if kind not in POLICIES:
            raise DataError(f"checkpoint {folder}: {unknown_name('policy', kind, POLICIES).message}")
    return POLICIES[kind].load(folder, device, threads)
