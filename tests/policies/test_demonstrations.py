"""Phases, keyframes and splits of demonstrations."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.errors import DataError
from minidual.policies.demonstrations import Demonstrations, gripper_switches, split_episodes
from tests.support.training_samples import tiny


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
