"""Small demonstrations and trainings for the tests of learned policies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from minidual.config.learning import TrainConfig
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.kinds import POLICIES, Training, TrainResult
from tests.support.late import late

torch = late("torch")
tensor_files = late("safetensors.torch")

SMALL = {
    "chunk_size": 10,
    "dim_model": 32,
    "dim_feedforward": 64,
    "heads": 4,
    "encoder_layers": 1,
    "keypoints": 8,
    "batch_size": 4,
    "steps": 4,
    "threads": 1,
    "log_every_steps": 2,
    "validate_every_steps": 2,
}
"""Settings of a training of a fraction of a second."""

RESULT = TrainResult(
    steps=100,
    steps_asked=100,
    train_s=60.0,
    samples_per_s=400.0,
    parameters=770_000,
    loss_initial=1.0,
    loss_final=0.05,
    loss_ratio=0.05,
    validation_l1=0.06,
    validation_keyframe_rad=0.004,
    training_episodes=[0, 1],
    validation_episodes=[2],
    ticks=1200,
    bf16=True,
    resumed_from_step=0,
    stopped_by="steps",
)
"""Of a training that passes every limit."""


def tiny(
    ticks: int = 60,
    episodes: int = 3,
    seed: int = 0,
    size: tuple[int, int] = (12, 16),
) -> Demonstrations:
    """Return episodes of random postures whose hands close at tick 20 and open at tick 50."""
    rng = np.random.default_rng(seed)
    n = ticks * episodes
    action = rng.normal(0, 1, (n, 16)).astype(np.float32)
    opening = np.ones(ticks, np.float32)
    opening[20:50] = 0.0
    action[:, 14:] = np.tile(opening, episodes)[:, None]
    images = rng.integers(0, 256, (n, *size, 3), dtype=np.uint8)
    state = rng.normal(0, 1, (n, 16)).astype(np.float32)
    episode_index = np.repeat(np.arange(episodes), ticks).astype(np.int64)
    return Demonstrations({"high": images}, state, action, episode_index)


def train(
    demos: Demonstrations,
    config: TrainConfig,
    seed: int,
    folder: Path,
    **options: Any,
) -> TrainResult:
    """Train the policy that the configuration names; `options` are those of `Training`."""
    return POLICIES[config.policy].train(Training(demos, config, seed, **options), folder)


def weights(checkpoint: Path) -> dict[str, torch.Tensor]:
    """Return the weights of a checkpoint."""
    return tensor_files.load_file(checkpoint / "model.safetensors")


def same(first: dict[str, torch.Tensor], second: dict[str, torch.Tensor]) -> bool:
    """Return whether two sets of weights are equal to the bit."""
    if first.keys() != second.keys():
        return False
    return all(torch.equal(first[name], second[name]) for name in first)
