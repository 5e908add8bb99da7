"""Normalisation statistics in LeRobot's layout."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from minidual.demos.lerobot_reader import ACTION, STATE, camera_key
from minidual.policies.demonstrations import Demonstrations

LEROBOT_EPS = 1e-8
"""Added to std by LeRobot's processors."""
IMAGE_SAMPLE = 512

Stats = dict[str, dict[str, Tensor]]


def dataset_statistics(demos: Demonstrations, rows: NDArray[np.int64], std_floor: float) -> Stats:
    """Return mean and std over `rows`.

    State and action: (dim,). Images: (3, 1, 1) in [0, 1], from 512 frames. `std_floor` is the least std.
    """
    stats: Stats = {}
    for key, array in ((STATE, demos.state), (ACTION, demos.action)):
        values = array[rows].astype(np.float64)
        stats[key] = _mean_std(values.mean(axis=0), values.std(axis=0), std_floor)
    chosen = rows[np.linspace(0, len(rows) - 1, min(IMAGE_SAMPLE, len(rows))).astype(np.int64)]
    for camera in demos.cameras:
        pixels = demos.images[camera][chosen].reshape(-1, 3)
        mean = np.array([pixels[:, c].mean(dtype=np.float64) for c in range(3)]) / 255.0
        std = np.array([pixels[:, c].std(dtype=np.float64) for c in range(3)]) / 255.0
        stats[camera_key(camera)] = _mean_std(mean[:, None, None], std[:, None, None], std_floor)
    return stats


def _mean_std(mean: NDArray[np.float64], std: NDArray[np.float64], floor: float) -> dict[str, Tensor]:
    return {
        "mean": torch.from_numpy(mean.astype(np.float32)),
        "std": torch.from_numpy(np.maximum(std, floor).astype(np.float32)),
    }


def normalise(values: Tensor, stats: dict[str, Tensor]) -> Tensor:
    """Return (values - mean) / (std + eps)."""
    return (values - stats["mean"]) / (stats["std"] + LEROBOT_EPS)


def normalise_images(images: Tensor, stats: dict[str, Tensor]) -> Tensor:
    """Normalise uint8 (B, H, W, 3) to channels-last float (B, 3, H, W)."""
    inverse = 1.0 / (stats["std"].view(1, 1, 1, 3) + LEROBOT_EPS)
    normalised = torch.addcmul(-stats["mean"].view(1, 1, 1, 3) * inverse, images.float(), inverse / 255.0)
    return normalised.permute(0, 3, 1, 2)
