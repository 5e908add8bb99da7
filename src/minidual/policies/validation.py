"""Errors of a policy on episodes held out from training."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch

from minidual.demos.lerobot_reader import ACTION, Rows
from minidual.policies.batches import Batch, BatchMaker, Stats

ROWS_MAX = 512
BATCH_ROWS = 64


class ValidationErrors(NamedTuple):
    """Mean errors; None without held-out rows or keyframes.

    Attributes:
        l1: In units of the action's std.
    """

    l1: float | None = None
    keyframe_rad: float | None = None


class Validation:
    """Measures policies on held-out rows."""

    def __init__(
        self, batches: BatchMaker, rows: Rows, stats: Stats, joints: Sequence[int]
    ) -> None:
        self._batches = batches
        count = min(ROWS_MAX, len(rows))
        self._rows = rows[np.linspace(0, len(rows) - 1, count).astype(np.int64)]
        self._action_std = stats[ACTION]["std"]
        self._joints = list(joints)

    @torch.no_grad()
    def measure(self, policy: Any) -> ValidationErrors:
        """Return the errors; `policy` is in evaluation mode afterwards."""
        if not len(self._rows):
            return ValidationErrors()
        l1: list[float] = []
        keyframe_rad: list[torch.Tensor] = []
        for start in range(0, len(self._rows), BATCH_ROWS):
            batch = self._batches.clean(self._rows[start : start + BATCH_ROWS])
            observation = {
                key: values for key, values in batch.items() if key.startswith("observation.")
            }
            policy.reset()
            chunk = policy.predict_action_chunk(observation)
            l1.extend((chunk - batch[ACTION]).abs().mean(dim=(1, 2)).tolist())
            if getattr(policy.config, "keyframes", 0):
                _, _, keyframes = policy.model(observation)
                keyframe_rad.append(self._keyframe_errors(keyframes, batch))
        errors_rad = torch.cat(keyframe_rad) if keyframe_rad else torch.zeros(0)
        return ValidationErrors(
            l1=float(np.mean(l1)),
            keyframe_rad=float(errors_rad.mean()) if errors_rad.numel() else None,
        )

    def _keyframe_errors(self, keyframes: torch.Tensor, batch: Batch) -> torch.Tensor:
        """Return the mean joint error [rad] of each keyframe to come."""
        normalised = (keyframes - batch["keyframe"]).abs()
        errors = normalised * self._action_std.to(normalised.device)
        return errors[..., self._joints].mean(-1)[batch["keyframe_is_valid"]]
