"""Kinds of policy: how each is trained, and how its checkpoints are loaded and asked for actions. POLICIES lists them.

A checkpoint is a folder with a config.json whose "type" names its kind; everything else in it is the kind's own.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from minidual.config.learning import TrainConfig
from minidual.errors import DataError, unknown_name
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.records import TrainResult
from minidual.registry import Registry

Image = NDArray[np.uint8]
Advance = Callable[[int, float], None]
"""Called with (steps since the last call, loss)."""
REMEDY = "minidual train-act"


class ChunkPolicy(ABC):
    """A loaded checkpoint.

    Attributes:
        cameras: Cameras that it looks through, with image size (H, W).
        chunk_size: Actions that one inference predicts.
        dim: Entries of state and action: all joints, then two grippers.
    """

    cameras: Mapping[str, tuple[int, int]]
    chunk_size: int
    dim: int

    @abstractmethod
    def predict(self, images: Mapping[str, Image], state: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the next actions (chunk_size, dim): joint targets [rad], then openings.

        Args:
            images: (H, W, 3) uint8 for each of `cameras`.
            state: (dim,) measured joints [rad], then openings.
        """


class PolicyKind(ABC):
    """One row of POLICIES."""

    def require(self, device: str) -> None:  # noqa: B027 (most kinds run anywhere)
        """Raise EnvironmentMissingError if this kind cannot run on `device` ("cpu" or "cuda") here."""

    @abstractmethod
    def train(
        self,
        demos: Demonstrations,
        config: TrainConfig,
        seed: int,
        folder: Path,
        *,
        resume_dir: Path | None = None,
        advance: Advance | None = None,
    ) -> TrainResult:
        """Train on demonstrations and write the checkpoint `folder`, which appears only when it is whole.

        Args:
            demos: Read, never changed.
            config: `config.policy` is this kind's name; what does not apply to it is ignored.
            seed: The same seed, data and settings give the same checkpoint on a CPU.
            folder: To make.
            resume_dir: Where an interrupted training leaves its progress, and goes on from; None keeps none.
            advance: Progress.

        Raises:
            DataError: The dataset cannot be used, or `folder` exists.
            UsageError: A setting makes the training fail.
            EnvironmentMissingError: The device is missing.
        """

    @abstractmethod
    def load(self, folder: Path, device: str, threads: int | None) -> ChunkPolicy:
        """Load a checkpoint without network; `threads` for numeric libraries, None leaves them.

        Raises:
            DataError: The checkpoint is missing or corrupt.
            EnvironmentMissingError: The device is missing.
        """


POLICIES: Registry[PolicyKind] = Registry(
    "policy",
    {"spatial_act": "minidual.policies.act:SPATIAL_ACT", "act": "minidual.policies.act:ACT_KIND"},
    group="minidual.policies",
)
"""Kinds by the name that `train.policy` takes and checkpoints carry."""


def load_policy(folder: Path, device: str = "cpu", threads: int | None = None) -> ChunkPolicy:
    """Load a checkpoint of any kind; raises as `PolicyKind.load`."""
    if not folder.is_dir():
        raise DataError(f"there is no checkpoint folder {folder}", remedy=REMEDY)
    path = folder / "config.json"
    if not path.is_file():
        raise DataError(f"checkpoint {folder} lacks config.json", remedy=f"{REMEDY} --force")
    try:
        kind = json.loads(path.read_text(encoding="utf-8"))["type"]
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"{path} names no policy type", remedy=f"{REMEDY} --force") from error
    if kind not in POLICIES:
        raise DataError(f"checkpoint {folder}: {unknown_name('policy', str(kind), POLICIES).message}", remedy=REMEDY)
    return POLICIES[kind].load(folder, device, threads)
