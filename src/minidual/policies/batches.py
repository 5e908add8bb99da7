"""Normalised training batches from demonstrations; statistics in LeRobot's layout."""

from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from minidual.config.learning import TrainConfig
from minidual.config.seeds import stream
from minidual.demos.lerobot_reader import ACTION, STATE, Rows, camera_key, colours
from minidual.demos.lerobot_video import Image
from minidual.demos.signals import DRIVERS, Driver
from minidual.errors import DataError
from minidual.policies.augment import augment
from minidual.policies.demonstrations import Demonstrations
from minidual.robot.pair import Array

LEROBOT_EPS = 1e-8
"""Added to std by LeRobot's processors."""
STATISTICS_IMAGES = 512
JOINT_STD_RAD = 0.3
"""Usual standard deviation of a joint here; noise of inputs, and of joints in unknown units, is
scaled by it."""

Stats = dict[str, dict[str, Tensor]]
Batch = dict[str, Tensor]


def dataset_statistics(demos: Demonstrations, rows: Rows, std_floor: float) -> Stats:
    """Return mean and std over `rows`.

    State and action: (dim,). Images: (3, 1, 1) in [0, 1], from 512 frames. `std_floor` is the least
    std.
    """
    stats: Stats = {}
    for key, array in ((STATE, demos.state), (ACTION, demos.action)):
        values = array[rows].astype(np.float64)
        stats[key] = _mean_std(values.mean(axis=0), values.std(axis=0), std_floor)
    sampled = rows[_spread(len(rows), STATISTICS_IMAGES)]
    for camera in demos.cameras:
        mean, std = colours(demos.images[camera][sampled])
        stats[camera_key(camera)] = _mean_std(mean[:, None, None], std[:, None, None], std_floor)
    return stats


def _spread(count: int, samples_max: int) -> Rows:
    """Return evenly spaced indices below `count`, at most `samples_max`."""
    return np.linspace(0, count - 1, min(samples_max, count)).astype(np.int64)


def _mean_std(mean: Array, std: Array, floor: float) -> dict[str, Tensor]:
    floored = np.maximum(std, floor)
    return {
        "mean": torch.from_numpy(mean.astype(np.float32)),
        "std": torch.from_numpy(floored.astype(np.float32)),
    }


def normalise(values: Tensor, stats: dict[str, Tensor]) -> Tensor:
    """Return (values - mean) / (std + eps)."""
    return (values - stats["mean"]) / (stats["std"] + LEROBOT_EPS)


def normalise_images(images: Tensor, stats: dict[str, Tensor]) -> Tensor:
    """Normalise uint8 (B, H, W, 3) to channels-last float (B, 3, H, W)."""
    mean = stats["mean"].view(1, 1, 1, 3)
    inverse_std = 1.0 / (stats["std"].view(1, 1, 1, 3) + LEROBOT_EPS)
    channels_last = torch.addcmul(-mean * inverse_std, images.float(), inverse_std / 255.0)
    return channels_last.permute(0, 3, 1, 2)


class BatchMaker:
    """Cuts action chunks, augments, normalises.

    Past an episode's end a chunk repeats its last command, at rest.
    """

    def __init__(self, demos: Demonstrations, config: TrainConfig, stats: Stats) -> None:
        self._demos = demos
        self._config = config
        self._noisy = [*demos.state_joints, *demos.state_inputs]
        self._noise_scale = self._scale_of_noise(demos, stats)
        self._stats: Stats = {}
        for key, values in stats.items():
            self._stats[key] = {name: value.to(config.device) for name, value in values.items()}

    def _scale_of_noise(self, demos: Demonstrations, stats: Stats) -> Array:
        """Return one radian of state noise in the units of each joint and input."""
        std = stats[STATE]["std"].numpy().astype(float)
        scale = std / JOINT_STD_RAD
        if demos.takes is None or demos.takes.radians:
            scale[demos.state_joints] = 1.0
        return scale[self._noisy]

    def training(self, rows: Rows, rng: np.random.Generator) -> Batch:
        """Return an augmented batch."""
        demos = self._demos
        config = self._config
        state = demos.state[rows].copy()
        in_approach = demos.phase[rows] == 0
        sigma = np.where(in_approach, config.state_noise_approach_rad, config.state_noise_rad)
        noise = rng.standard_normal((len(rows), len(self._noisy))) * sigma[:, None]
        state[:, self._noisy] += (noise * self._noise_scale).astype(np.float32)
        pictures = {
            camera: augment(demos.images[camera][rows], config.augment, rng)
            for camera in demos.cameras
        }
        return self._assemble(rows, state, pictures)

    def clean(self, rows: Rows) -> Batch:
        """Return an unaugmented batch."""
        demos = self._demos
        pictures = {camera: demos.images[camera][rows] for camera in demos.cameras}
        return self._assemble(rows, demos.state[rows], pictures)

    def _assemble(
        self,
        rows: Rows,
        state: NDArray[np.float32],
        pictures: dict[str, Image],
    ) -> Batch:
        demos = self._demos
        rows_ahead = rows[:, None] + np.arange(self._config.chunk_size)
        last_rows = demos.last_tick[rows][:, None]
        chunk = demos.action[np.minimum(rows_ahead, last_rows)]
        keyframe_rows = demos.keyframe_ticks[rows]
        exists = keyframe_rows >= 0
        switches_n = keyframe_rows.shape[1]
        to_come = exists & (np.arange(switches_n) >= demos.phase[rows][:, None])
        batch: Batch = {
            STATE: self._normalised(STATE, state),
            ACTION: self._normalised(ACTION, chunk),
            "action_is_pad": torch.zeros(
                chunk.shape[:2],
                dtype=torch.bool,
                device=self._config.device,
            ),
            "keyframe": self._normalised(ACTION, demos.action[keyframe_rows]),
            "keyframe_is_valid": self._on_device(to_come),
        }
        for camera in demos.cameras:
            key = camera_key(camera)
            batch[key] = normalise_images(self._on_device(pictures[camera]), self._stats[key])
        return batch

    def _normalised(self, key: str, values: NDArray[np.float32]) -> Tensor:
        return normalise(self._on_device(values), self._stats[key])

    def _on_device(self, values: NDArray[np.generic]) -> Tensor:
        return torch.from_numpy(values).to(self._config.device)


def driver_weights(driver: Rows, config: TrainConfig) -> Array:
    """Return the sampling weight of ticks (N,) by their driver (N,).

    Raises:
        DataError: No tick has any weight.
    """
    by_driver = {
        Driver.LEADER: 1.0,
        Driver.POLICY: config.own_weight,
        Driver.CORRECTION: config.correction_weight,
    }
    weights = np.array([by_driver[name] for name in DRIVERS])[driver]
    if not weights.any():
        raise DataError(
            "no tick has a weight: the policy drove all of them",
            remedy="add demonstrations, or --set train.own_weight=1",
        )
    return weights


class DrawnBatch(NamedTuple):
    """The batch of a step, and the seed of the policy's random draws in it."""

    seed: int
    tensors: Batch


class BatchStream:
    """Draws each step's batch from the stream (seed, step).

    The next batch is cut on a thread of its own while the gradient is computed: it takes a sixth of
    a step.
    """

    def __init__(
        self,
        maker: BatchMaker,
        demos: Demonstrations,
        rows: Rows,
        config: TrainConfig,
        seed: int,
    ) -> None:
        self._maker = maker
        self._config = config
        self._seed = seed
        self._rows = rows
        weights = np.where(demos.phase[rows] == 0, config.approach_weight, 1.0)
        if demos.driver is not None:
            weights = weights * driver_weights(demos.driver[rows], config)
        self._probabilities = weights / weights.sum()
        self._pool = ThreadPoolExecutor(1)
        self._next: Future[DrawnBatch] | None = None

    def take(self, step: int) -> DrawnBatch:
        """Return the batch of `step`; steps are taken in ascending order."""
        drawn = self._draw(step) if self._next is None else self._next.result()
        is_last = step + 1 >= self._config.steps
        self._next = None if is_last else self._pool.submit(self._draw, step + 1)
        return drawn

    def close(self) -> None:
        """End the thread."""
        self._pool.shutdown(cancel_futures=True)

    def _draw(self, step: int) -> DrawnBatch:
        rng = stream(self._seed, "train.batch", step)
        seed = int(rng.integers(2**63))
        rows = rng.choice(self._rows, self._config.batch_size, p=self._probabilities)
        return DrawnBatch(seed, self._maker.training(rows, rng))
