"""A recorded episode leads along its commands."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.leading import ReplayConfig
from minidual.config.scene import SceneConfig
from minidual.demos.leaders.replay import ReplayLeader
from minidual.demos.station import Button
from minidual.errors import UsageError
from minidual.robot.models import ARM_MODELS
from minidual.robot.pair import DUAL_PANDA, Robot
from tests.support import data_samples
from tests.support.carry_trials import sample_trial


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for index in range(2):
        data = data_samples.arrays(seed=index, cameras=("high",))
        data_samples.write(tmp_path / f"episode_{index:06d}.hdf5", data)
    return tmp_path


def leader_of(path: Path, scene: SceneConfig, episode: int = -1, trial: int = 0) -> ReplayLeader:
    config = ReplayConfig(path=str(path), episode=episode)
    leader = ReplayLeader(DUAL_PANDA, config)
    leader.align(sample_trial(scene, 1, "demonstrations", trial), DUAL_PANDA.home)
    return leader


def action_of(seed: int) -> Any:
    return data_samples.arrays(seed=seed, cameras=("high",))


def test_the_commands_of_a_file_are_played_to_their_end(folder: Path, scene: SceneConfig) -> None:
    leader = leader_of(folder / "episode_000001.hdf5", scene)
    recorded = action_of(1)
    for k in range(40):
        sample = leader.read(k / 50)
        assert sample is not None
        np.testing.assert_array_equal(sample.q, recorded["action"][k])
        np.testing.assert_array_equal(sample.openings, recorded["action_gripper"][k])
        assert sample.pressed == ()
    last = leader.read(40 / 50)
    assert last is not None
    assert last.pressed == (Button.SUCCESS,)


@pytest.mark.parametrize(("episode", "trial", "expected"), [(-1, 1, 1), (0, 1, 0)])
def test_the_trial_or_the_setting_chooses_the_episode_of_a_folder(
    folder: Path,
    scene: SceneConfig,
    episode: int,
    trial: int,
    expected: int,
) -> None:
    sample = leader_of(folder, scene, episode, trial).read(0.0)
    assert sample is not None
    np.testing.assert_array_equal(sample.q, action_of(expected)["action"][0])


def test_an_episode_that_does_not_exist_is_refused(folder: Path, scene: SceneConfig) -> None:
    with pytest.raises(UsageError, match=r"episode 7 of .* there are 0 to 1"):
        leader_of(folder, scene, episode=7)


@pytest.mark.parametrize("path", ["", "nowhere"])
def test_a_path_with_nothing_is_refused(path: str) -> None:
    with pytest.raises(UsageError, match="where there is nothing"):
        ReplayLeader(DUAL_PANDA, ReplayConfig(path=path))


def test_an_episode_of_other_arms_is_refused(folder: Path, scene: SceneConfig) -> None:
    arms = Robot(ARM_MODELS["ur5"])
    leader = ReplayLeader(arms, ReplayConfig(path=str(folder)))
    with pytest.raises(UsageError, match="the episode has 14 joints, the arms have 12"):
        leader.align(sample_trial(scene, 1, "demonstrations", 0), arms.home)
