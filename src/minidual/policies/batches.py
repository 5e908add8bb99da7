"""From rows of the demonstrations to the normalised batch that a LeRobot ACT policy is trained on."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from minidual.config.learning import TrainConfig
from minidual.policies.demonstrations import JOINTS_N, Demonstrations
from minidual.policies.normalisation import Stats, image_key, normalise, normalise_images


class BatchMaker:
    """Cuts action chunks, adds state noise and image jitter, normalises.

    A chunk that reaches past the end of its episode repeats the last command: demonstrations end at rest, so
    holding is what the demonstrator would do.
    """

    def __init__(self, demos: Demonstrations, config: TrainConfig, stats: Stats) -> None:
        self._demos = demos
        self._config = config
        self._stats = {key: {n: t.to(config.device) for n, t in s.items()} for key, s in stats.items()}

    def training(self, rows: NDArray[np.int64], rng: np.random.Generator) -> dict[str, Tensor]:
        """Return a batch with noise and jitter drawn from `rng`."""
        config = self._config
        state = self._demos.state[rows].copy()
        sigma = np.where(self._demos.phase[rows] == 0, config.state_noise_approach_rad, config.state_noise_rad)
        state[:, :JOINTS_N] += (rng.standard_normal((len(rows), JOINTS_N)) * sigma[:, None]).astype(np.float32)
        contrast = 1.0 + rng.uniform(-1.0, 1.0, len(rows)) * config.contrast_jitter
        brightness = rng.uniform(-1.0, 1.0, len(rows)) * config.brightness_jitter
        return self._assemble(
            rows, state, torch.from_numpy(contrast.astype(np.float32)), torch.from_numpy(brightness.astype(np.float32))
        )

    def clean(self, rows: NDArray[np.int64]) -> dict[str, Tensor]:
        """Return a batch as recorded: no noise, no jitter."""
        return self._assemble(rows, self._demos.state[rows], None, None)

    def _assemble(
        self, rows: NDArray[np.int64], state: NDArray[np.float32], contrast: Tensor | None, brightness: Tensor | None
    ) -> dict[str, Tensor]:
        demos, device = self._demos, self._config.device
        ahead = rows[:, None] + np.arange(self._config.chunk_size)
        chunk = demos.action[np.minimum(ahead, demos.last_tick[rows][:, None])]
        ticks = demos.keyframe_ticks[rows]
        is_next = (ticks >= 0) & (np.arange(demos.keyframes_n) == demos.phase[rows][:, None])
        batch: dict[str, Tensor] = {
            "observation.state": normalise(torch.from_numpy(state).to(device), self._stats["observation.state"]),
            "action": normalise(torch.from_numpy(chunk).to(device), self._stats["action"]),
            "action_is_pad": torch.zeros(chunk.shape[:2], dtype=torch.bool, device=device),
            "keyframe": normalise(torch.from_numpy(demos.action[ticks]).to(device), self._stats["action"]),
            "keyframe_is_valid": torch.from_numpy(is_next).to(device),
        }
        for camera in demos.cameras:
            pixels = torch.from_numpy(demos.images[camera][rows]).to(device)
            key = image_key(camera)
            batch[key] = normalise_images(
                pixels,
                self._stats[key],
                None if contrast is None else contrast.to(device),
                None if brightness is None else brightness.to(device),
            )
        return batch
