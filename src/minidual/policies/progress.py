"""The progress of a training, saved so that an interrupted one can go on."""

import hashlib
import io
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import torch

from minidual import durable
from minidual.config.learning import TrainConfig
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.kinds import LossRow
from minidual.policies.shares import BatchLoss

DIGEST_BYTES = 32
"""Of the SHA-256 with which a progress file begins."""
FIRST_STEPS = 5
"""Steps that make the initial loss."""
FINGERPRINT_IMAGES = 256
SETTINGS_WITHOUT_INFLUENCE = {
    "seeds_n",
    "log_every_steps",
    "validate_every_steps",
    "checkpoint_every_steps",
    "time_limit_s",
    "loss_ratio_max",
    "actions_in_limits_min",
}
"""Settings of `TrainConfig` that do not change the weights."""


class Loss(NamedTuple):
    """The loss of a step and its parts, or means over steps.

    Demonstrations without keyframes have no keyframe loss.
    """

    total: float
    l1: float
    keyframe: float | None


@dataclass
class TrainState:
    """Course of a training.

    Attributes:
        first_l1: Of the first steps.
        recent: Of the steps since the last row of the curve.
    """

    step: int = 0
    spent_s: float = 0.0
    first_l1: list[float] = field(default_factory=list)
    recent: list[Loss] = field(default_factory=list)
    curve: list[LossRow] = field(default_factory=list)

    @property
    def logged_step(self) -> int:
        """Step of the last row of the curve, or 0."""
        return self.curve[-1].step if self.curve else 0

    @property
    def last_loss(self) -> float:
        """Loss of the last step or row."""
        return self.recent[-1].total if self.recent else self.curve[-1].loss

    def add(self, batch_loss: BatchLoss) -> None:
        """Note the losses of a step."""
        l1 = batch_loss.parts["l1_loss"]
        keyframe = batch_loss.parts.get("keyframe_loss")
        self.recent.append(Loss(batch_loss.loss, l1, keyframe))
        if len(self.first_l1) < FIRST_STEPS:
            self.first_l1.append(l1)

    def recent_mean(self) -> Loss:
        """Return the means over `recent`."""
        keyframes = [step.keyframe for step in self.recent if step.keyframe is not None]
        return Loss(
            total=float(np.mean([step.total for step in self.recent])),
            l1=float(np.mean([step.l1 for step in self.recent])),
            keyframe=float(np.mean(keyframes)) if keyframes else None,
        )

    def record(self) -> dict[str, Any]:
        """Return plain values for `from_record`."""
        return {
            "step": self.step,
            "spent_s": self.spent_s,
            "first_l1": list(self.first_l1),
            "recent": [tuple(step) for step in self.recent],
            "curve": [asdict(row) for row in self.curve],
        }

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> Self:
        """Return the state of a record."""
        return cls(
            step=record["step"],
            spent_s=record["spent_s"],
            first_l1=record["first_l1"],
            recent=[Loss(*step) for step in record["recent"]],
            curve=[LossRow(**row) for row in record["curve"]],
        )


class ProgressFile:
    """Progress of the training with a fingerprint; `path` None keeps none.

    Args:
        name: Of the command, in the names of files that are set aside.

    Attributes:
        set_aside: Where damaged progress or that of another training was moved, or None.
    """

    def __init__(self, path: Path | None, fingerprint: str, name: str = "train-act") -> None:
        self._path = path
        self._fingerprint = fingerprint
        self._name = name
        self.set_aside: Path | None = None

    def write(self, record: dict[str, Any]) -> None:
        """Replace the file by a record of plain values and tensors."""
        if self._path is None:
            return
        stream = io.BytesIO()
        torch.save({"fingerprint": self._fingerprint, **record}, stream)
        content = stream.getbuffer()
        with durable.replacing(self._path) as partial:
            partial.write_bytes(hashlib.sha256(content).digest() + content)

    def read(self, device: str) -> dict[str, Any] | None:
        """Return this training's record; move any other file to `set-aside` beside it."""
        if self._path is None or not self._path.exists():
            return None
        stored = self._path.read_bytes() if self._path.is_file() else b""
        digest = stored[:DIGEST_BYTES]
        content = stored[DIGEST_BYTES:]
        # The checksum comes first: a damaged file would fail while it is loaded, or in training.
        if hashlib.sha256(content).digest() != digest:
            self.set_aside = durable.set_aside(self._path, f"{self._name}.damaged-progress")
            return None
        record = torch.load(io.BytesIO(content), map_location=device, weights_only=True)
        if record.get("fingerprint") != self._fingerprint:
            self.set_aside = durable.set_aside(self._path, f"{self._name}.other-progress")
            return None
        return record


def training_fingerprint(demos: Demonstrations, config: TrainConfig, seed: int, policy: Any) -> str:
    """Return a hash of everything that determines the weights (images sampled)."""
    digest = hashlib.sha256()
    settings = config.model_dump(exclude=SETTINGS_WITHOUT_INFLUENCE)
    if config.budget_s is not None:
        del settings["steps"]  # counted when the training began, and kept in its progress
    layout = [(name, list(values.shape)) for name, values in policy.state_dict().items()]
    description = [seed, settings, layout, torch.__version__]
    digest.update(json.dumps(description, sort_keys=True).encode())
    for array in (demos.state, demos.action, demos.episode_index):
        digest.update(array.tobytes())
    if demos.driver is not None:
        digest.update(demos.driver.tobytes())
    every = max(1, len(demos) // FINGERPRINT_IMAGES)
    for camera in demos.cameras:
        digest.update(camera.encode())
        digest.update(demos.images[camera][::every].tobytes())
    return digest.hexdigest()
