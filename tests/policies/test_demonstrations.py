"""Phases, keyframes, splits, weighted sampling, normalisation: what a batch is made of."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.learning import TrainConfig
from minidual.demos.lerobot_reader import camera_key
from minidual.errors import DataError
from minidual.policies.demonstrations import Demonstrations, gripper_switches, split_episodes
from tests.support.late import late
from tests.support.learning_world import APPROACH, demonstrations

torch = late("torch")
batches = late("minidual.policies.batches")
pytestmark = pytest.mark.torch


def tiny(ticks: int = 60, episodes: int = 3, seed: int = 0) -> Demonstrations:
    """Episodes of random walks that close at tick 20 and open at tick 50."""
    rng = np.random.default_rng(seed)
    n = ticks * episodes
    action = rng.normal(0, 1, (n, 16)).astype(np.float32)
    opening = np.ones(ticks, np.float32)
    opening[20:50] = 0.0
    action[:, 14:] = np.tile(opening, episodes)[:, None]
    return Demonstrations(
        {"high": rng.integers(0, 256, (n, 12, 16, 3), dtype=np.uint8)},
        rng.normal(0, 1, (n, 16)).astype(np.float32),
        action,
        np.repeat(np.arange(episodes), ticks).astype(np.int64),
    )


def test_phase_and_keyframes_follow_the_gripper_command() -> None:
    demos = tiny()
    assert demos.phase[:21].tolist() == [0] * 21  # the closing tick ends the approach
    assert demos.phase[21:51].tolist() == [1] * 30
    assert demos.phase[51:60].tolist() == [2] * 9
    assert (demos.keyframe_ticks[60:120] == [80, 110]).all()
    assert demos.last_tick[[0, 59, 60]].tolist() == [59, 59, 119]


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("scale", [1.0, 0.04])
def test_switches_are_found_in_commands_of_either_sign_and_in_metres(
    flip: bool,
    scale: float,
) -> None:
    opening = np.ones((100, 2), np.float32)
    opening[30:80, 0] = 0
    opening[34:79, 1] = 0  # the other hand follows four ticks later: one event
    gripper = scale * (1 - opening if flip else opening)
    assert gripper_switches(gripper, np.ptp(gripper, axis=0)) == [30, 79]


def test_a_gripper_that_never_moves_has_no_switch() -> None:
    assert gripper_switches(np.ones((50, 2), np.float32), np.zeros(2, np.float32)) == []


def test_split_is_by_episode_disjoint_and_repeatable() -> None:
    episodes = list(range(20))
    training, validation = split_episodes(episodes, 0.1, np.random.default_rng(3))
    assert len(validation) == 2
    assert sorted(training + validation) == episodes
    assert (training, validation) == split_episodes(episodes, 0.1, np.random.default_rng(3))
    assert split_episodes([7], 0.5, np.random.default_rng(0)) == ([7], [])
    assert split_episodes(episodes, 0.0, np.random.default_rng(0))[1] == []


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


def test_unusable_datasets_are_refused_with_the_column_and_the_episode() -> None:
    demos = tiny()
    with pytest.raises(DataError, match="'action' has shape"):
        Demonstrations(demos.images, demos.state, demos.action[:, :14], demos.episode_index)
    with pytest.raises(DataError, match="not ascending"):
        Demonstrations(demos.images, demos.state, demos.action, demos.episode_index[::-1].copy())
    with pytest.raises(DataError, match="no camera images"):
        Demonstrations({}, demos.state, demos.action, demos.episode_index)
    with pytest.raises(DataError, match="no ticks"):
        Demonstrations({}, demos.state[:0], demos.action[:0], demos.episode_index[:0])


def test_the_toy_world_closes_after_its_approach() -> None:
    demos = demonstrations(1, seed=0, every=10)
    assert demos.keyframe_ticks[0].tolist() == [APPROACH // 10]
