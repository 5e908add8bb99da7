"""What a training batch is made of: statistics, chunks, noise, normalised images."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.learning import TrainConfig
from minidual.demos.lerobot_reader import camera_key
from tests.support.late import late
from tests.support.training_samples import tiny

torch = late("torch")
batches = late("minidual.policies.batches")
pytestmark = pytest.mark.torch


def test_statistics_are_those_of_the_data_and_floored() -> None:
    demos = tiny()
    demos.state[:, 3] = 0.5  # a joint that never moves
    rows = np.arange(len(demos))
    stats = batches.dataset_statistics(demos, rows, 0.01)
    assert np.allclose(stats["action"]["mean"], demos.action.mean(axis=0), atol=1e-6)
    assert stats["observation.state"]["std"][3] == pytest.approx(0.01)
    pixels = demos.images["high"].reshape(-1, 3) / 255.0
    assert np.allclose(stats[camera_key("high")]["std"].flatten(), pixels.std(axis=0), atol=1e-6)
    assert np.allclose(stats[camera_key("high")]["mean"].flatten(), pixels.mean(axis=0), atol=1e-6)


def test_batch_holds_the_chunk_after_each_row_and_repeats_the_last_command() -> None:
    demos = tiny()
    stats = batches.dataset_statistics(demos, np.arange(len(demos)), 0.01)
    batch = batches.BatchMaker(demos, TrainConfig(chunk_size=10), stats).clean(
        np.array([5, 55, 100]),
    )
    actions = batch["action"] * stats["action"]["std"] + stats["action"]["mean"]
    assert np.allclose(actions[0], demos.action[5:15], atol=1e-5)
    expected = np.concatenate([demos.action[55:60], np.repeat(demos.action[59:60], 5, axis=0)])
    assert np.allclose(actions[1], expected, atol=1e-5)
    assert batch["keyframe_is_valid"].tolist() == [[True, True], [False, False], [False, True]]
    keyframe = batch["keyframe"] * stats["action"]["std"] + stats["action"]["mean"]
    assert np.allclose(keyframe[0, 0], demos.action[20], atol=1e-5)
    assert np.allclose(keyframe[2, 1], demos.action[110], atol=1e-5)


def test_state_noise_is_large_in_the_approach_and_small_after_it() -> None:
    demos = tiny()
    stats = batches.dataset_statistics(demos, np.arange(len(demos)), 0.01)
    config = TrainConfig(chunk_size=5, state_noise_approach_rad=0.06, state_noise_rad=0.01)
    maker = batches.BatchMaker(demos, config, stats)

    def noise(row: int) -> np.ndarray:
        rows = np.full(3000, row)
        noisy = maker.training(rows, np.random.default_rng(0))
        clean = maker.clean(rows)
        return (
            (noisy["observation.state"] - clean["observation.state"])
            * stats["observation.state"]["std"]
        ).numpy()

    assert noise(3)[:, :14].std() == pytest.approx(0.06, rel=0.03)
    assert noise(30)[:, :14].std() == pytest.approx(0.01, rel=0.03)
    assert np.abs(noise(3)[:, 14:]).max() == 0.0


def test_images_are_normalised_in_one_pass_as_by_hand() -> None:
    generator = torch.Generator().manual_seed(0)
    images = torch.randint(0, 256, (4, 6, 8, 3), generator=generator, dtype=torch.uint8)
    stats = {
        "mean": torch.tensor([0.3, 0.4, 0.5]).view(3, 1, 1),
        "std": torch.tensor([0.2, 0.1, 0.3]).view(3, 1, 1),
    }
    by_hand = (images.permute(0, 3, 1, 2) / 255.0 - stats["mean"]) / stats["std"]
    assert torch.allclose(batches.normalise_images(images, stats), by_hand, atol=1e-5)
