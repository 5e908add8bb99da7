"""Matings side by side: episodes begin anew in the same step, starts change, lost trials are left out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from minidual.errors import DataError, UsageError
from minidual.trials.lessons.mating_worlds import MatingWorlds
from tests.support.mating_trunks import SIZE, TERMS, Played, PlayedTrunks

CLEAN_TWICE = ("clean", "randomised")


def worlds_of(trunks: PlayedTrunks, conditions: Any = CLEAN_TWICE, **options: Any) -> MatingWorlds:
    return MatingWorlds(trunks, conditions, "toy", TERMS, **options)


def stepped(worlds: MatingWorlds, steps: int) -> list[Any]:
    actions = np.zeros((worlds.num_envs, 5))
    return [worlds.step(actions) for _ in range(steps)]


def test_episodes_that_end_begin_anew_in_the_same_step() -> None:
    worlds = worlds_of(PlayedTrunks({1: Played(2, success=False)}))
    first, _ = worlds.reset()
    assert first.shape == (2, SIZE)
    assert first[:, :3].tolist() == [[0, 1, 0], [1, 1, 0]]
    _, second, third = stepped(worlds, 3)
    observations, rewards, terminated, truncated, infos = second
    assert rewards.tolist() == [2.0, 2.0]
    assert (terminated.tolist(), truncated.tolist()) == ([False, False], [False, True])
    assert observations[:, 1:3].tolist() == [[1, 2], [2, 0]]
    assert infos["final_obs"][1, 1:3].tolist() == [1, 2]
    assert infos["final_info"]["success"].tolist() == [False, False]
    _, _, terminated, _, infos = third
    assert terminated.tolist() == [True, False]
    assert infos["final_info"]["success"].tolist() == [True, False]
    assert worlds.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP


def test_a_start_is_tried_some_times_then_the_next_one_is_taken() -> None:
    trunks = PlayedTrunks()
    worlds = worlds_of(trunks, ("clean",), episodes=2)
    worlds.reset()
    results = stepped(worlds, 12)
    starts = [int(step[0][0, 0]) for step in results if step[2][0]]
    assert starts == [0, 1, 1, 2]
    assert [trunk.closed for trunk in trunks.started] == [True, True, False]
    assert {trunk.start.purpose for trunk in trunks.started} == {"toy"}


def test_not_all_worlds_change_their_start_at_once() -> None:
    trunks = PlayedTrunks()
    worlds = worlds_of(trunks, ("clean",) * 4, episodes=4)
    worlds.reset()
    changed = []
    before = np.arange(4)
    for step in stepped(worlds, 12):
        changed.append(int(np.sum(step[0][:, 0] != before)))
        before = step[0][:, 0]
    assert [count for count in changed if count] == [1, 1, 1, 1]


def test_each_world_has_its_condition() -> None:
    trunks = PlayedTrunks()
    worlds_of(trunks).reset()
    assert [trunk.start.condition for trunk in trunks.started] == ["clean", "randomised"]


def test_trials_that_end_before_the_mating_are_left_out() -> None:
    trunks = PlayedTrunks({0: None, 2: None})
    worlds = worlds_of(trunks)
    first, _ = worlds.reset()
    assert first[:, 0].tolist() == [3, 1]
    assert worlds.lost_n == 2


def test_trials_that_all_end_before_the_mating_are_an_error() -> None:
    worlds = worlds_of(PlayedTrunks(dict.fromkeys(range(100))), ("clean",))
    with pytest.raises(DataError, match=r"50 trials ended before their mating; .* on the way"):
        worlds.reset()


def test_where_the_first_episode_counts_alone_a_world_rests_after_it() -> None:
    trunks = PlayedTrunks({1: Played(5)})
    worlds = worlds_of(trunks, once=True)
    worlds.reset()
    results = stepped(worlds, 5)
    assert [step[2].tolist() for step in results][2:] == [
        [True, False],
        [False, False],
        [False, True],
    ]
    assert [trunk.copies_n for trunk in trunks.started] == [1, 1]
    worlds.close()
    assert len(trunks.kept) == 2
    again = worlds_of(trunks, once=True)
    again.reset()
    assert [trunk.copies_n for trunk in trunks.started] == [2, 2]
    assert len(trunks.started) == 2


def test_closed_worlds_close_their_trunks() -> None:
    trunks = PlayedTrunks()
    worlds = worlds_of(trunks)
    worlds.reset()
    worlds.close()
    assert all(trunk.closed for trunk in trunks.started)


@pytest.mark.parametrize("actions", [np.zeros((1, 5)), np.full((2, 5), np.nan)])
def test_other_actions_are_refused(actions: Any) -> None:
    worlds = worlds_of(PlayedTrunks())
    worlds.reset()
    with pytest.raises(UsageError, match=r"actions are \(2, 5\) finite numbers"):
        worlds.step(actions)


def test_worlds_are_reset_before_they_are_stepped() -> None:
    worlds = worlds_of(PlayedTrunks())
    with pytest.raises(UsageError, match="before they were reset"):
        worlds.step(np.zeros((2, 5)))


def test_worlds_that_begin_again_leave_their_trials_and_take_others() -> None:
    trunks = PlayedTrunks()
    worlds = worlds_of(trunks)
    worlds.reset()
    worlds.step(np.zeros((2, 5)))
    first = list(trunks.started)
    worlds.reset()
    later = trunks.started[len(first) :]
    assert all(trunk.closed for trunk in first)
    assert [trunk.copies_n for trunk in later] == [1] * len(later)
    assert len(later) >= worlds.num_envs
    worlds.step(np.zeros((2, 5)))
