"""Normalised training batches from demonstrations, and their gradients; statistics in LeRobot's layout."""

import copy
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from minidual.config.learning import TrainConfig
from minidual.demos.lerobot_reader import ACTION, STATE, Image, Rows, camera_key, colours
from minidual.policies.augment import augment
from minidual.policies.demonstrations import Demonstrations
from minidual.robot.pair import Array

LEROBOT_EPS = 1e-8
"""Added to std by LeRobot's processors."""

Stats = dict[str, dict[str, Tensor]]
Losses = Mapping[str, float]


def dataset_statistics(demos: Demonstrations, rows: Rows, std_floor: float) -> Stats:
    """Return mean and std over `rows`.

    State and action: (dim,). Images: (3, 1, 1) in [0, 1], from 512 frames. `std_floor` is the least std.
    """
    stats: Stats = {}
    for key, array in ((STATE, demos.state), (ACTION, demos.action)):
        values = array[rows].astype(np.float64)
        stats[key] = _mean_std(values.mean(axis=0), values.std(axis=0), std_floor)
    chosen = rows[np.linspace(0, len(rows) - 1, min(512, len(rows))).astype(np.int64)]
    for camera in demos.cameras:
        mean, std = colours(demos.images[camera][chosen])
        stats[camera_key(camera)] = _mean_std(mean[:, None, None], std[:, None, None], std_floor)
    return stats


def _mean_std(mean: Array, std: Array, floor: float) -> dict[str, Tensor]:
    values = {"mean": mean, "std": np.maximum(std, floor)}
    return {name: torch.from_numpy(value.astype(np.float32)) for name, value in values.items()}


def normalise(values: Tensor, stats: dict[str, Tensor]) -> Tensor:
    """Return (values - mean) / (std + eps)."""
    return (values - stats["mean"]) / (stats["std"] + LEROBOT_EPS)


def normalise_images(images: Tensor, stats: dict[str, Tensor]) -> Tensor:
    """Normalise uint8 (B, H, W, 3) to channels-last float (B, 3, H, W)."""
    inverse = 1.0 / (stats["std"].view(1, 1, 1, 3) + LEROBOT_EPS)
    return torch.addcmul(
        -stats["mean"].view(1, 1, 1, 3) * inverse,
        images.float(),
        inverse / 255.0,
    ).permute(0, 3, 1, 2)


class BatchMaker:
    """Cuts action chunks, augments, normalises.

    Past an episode's end a chunk repeats its last command, at rest.
    """

    def __init__(self, demos: Demonstrations, config: TrainConfig, stats: Stats) -> None:
        self._demos = demos
        self._config = config
        self._stats = {
            key: {n: t.to(config.device) for n, t in s.items()} for key, s in stats.items()
        }

    def training(self, rows: Rows, rng: np.random.Generator) -> dict[str, Tensor]:
        """Return an augmented batch."""
        config = self._config
        state = self._demos.state[rows].copy()
        sigma = np.where(
            self._demos.phase[rows] == 0,
            config.state_noise_approach_rad,
            config.state_noise_rad,
        )
        n = self._demos.joints_n
        state[:, :n] += (rng.standard_normal((len(rows), n)) * sigma[:, None]).astype(np.float32)
        pictures = {
            c: augment(self._demos.images[c][rows], config.augment, rng)
            for c in self._demos.cameras
        }
        return self._assemble(rows, state, pictures)

    def clean(self, rows: Rows) -> dict[str, Tensor]:
        """Return an unaugmented batch."""
        demos = self._demos
        return self._assemble(
            rows,
            demos.state[rows],
            {c: demos.images[c][rows] for c in demos.cameras},
        )

    def _assemble(
        self,
        rows: Rows,
        state: NDArray[np.float32],
        pictures: dict[str, Image],
    ) -> dict[str, Tensor]:
        demos = self._demos
        device = self._config.device
        ahead = rows[:, None] + np.arange(self._config.chunk_size)
        chunk = demos.action[np.minimum(ahead, demos.last_tick[rows][:, None])]
        ticks = demos.keyframe_ticks[rows]
        to_come = (ticks >= 0) & (np.arange(ticks.shape[1]) >= demos.phase[rows][:, None])
        batch: dict[str, Tensor] = {
            STATE: normalise(torch.from_numpy(state).to(device), self._stats[STATE]),
            ACTION: normalise(torch.from_numpy(chunk).to(device), self._stats[ACTION]),
            "action_is_pad": torch.zeros(chunk.shape[:2], dtype=torch.bool, device=device),
            "keyframe": normalise(
                torch.from_numpy(demos.action[ticks]).to(device),
                self._stats[ACTION],
            ),
            "keyframe_is_valid": torch.from_numpy(to_come).to(device),
        }
        for camera in demos.cameras:
            key = camera_key(camera)
            batch[key] = normalise_images(
                torch.from_numpy(pictures[camera]).to(device),
                self._stats[key],
            )
        return batch


class Shares:
    """Copies of a policy with common weights and gradients of their own, for one share of a batch on each thread.

    Torch's own threads wait for each other in every layer, those with shares of their own once a step.
    `forward(batch)` of a policy returns (loss, parts); it must not draw random numbers if `count` is above 1.
    """

    def __init__(self, policy: Any, count: int) -> None:
        self.policies = [policy, *(_sharing(policy) for _ in range(count - 1))]
        self._parameters = [
            [p for p in own.parameters() if p.requires_grad] for own in self.policies
        ]
        self._pool = ThreadPoolExecutor(count, initializer=torch.set_num_threads, initargs=(1,))

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()

    def gradient(self, batch: dict[str, Tensor]) -> tuple[float, Losses]:
        """Leave the batch's mean gradient in the first policy; return loss and parts."""
        if len(self.policies) == 1:
            return _gradient(self.policies[0], batch)
        rows = len(next(iter(batch.values())))
        shares = [
            slice(*ends)
            for ends in pairwise(np.linspace(0, rows, len(self.policies) + 1).astype(int).tolist())
        ]
        weights = [(share.stop - share.start) / rows for share in shares]
        if not all(weights):
            raise ValueError(f"{rows} rows cannot be shared by {len(shares)} threads")
        split = [{key: values[share] for key, values in batch.items()} for share in shares]
        results = list(self._pool.map(_gradient, self.policies, split))
        for same in zip(*self._parameters, strict=True):
            if same[0].grad is not None:
                same[0].grad = sum(w * p.grad for w, p in zip(weights, same, strict=True))
        mean = lambda values: sum(w * v for w, v in zip(weights, values, strict=True))  # noqa: E731
        parts = {name: mean([parts[name] for _, parts in results]) for name in results[0][1]}
        return mean([loss for loss, _ in results]), parts


def _sharing(policy: Any) -> Any:
    other = copy.deepcopy(policy)
    for own, common in zip(other.parameters(), policy.parameters(), strict=True):
        own.data = common.data
    return other


def _gradient(policy: Any, batch: dict[str, Tensor]) -> tuple[float, Losses]:
    policy.zero_grad(set_to_none=True)
    loss, parts = policy.forward(batch)
    loss.backward()
    return float(loss.detach()), parts
