"""The rule that shows a mating: it turns by the gaps, draws back what is stuck, and tries other signs."""

from __future__ import annotations

import numpy as np

from minidual.config.seeds import stream
from minidual.environments.mating import RelativePose, mating_columns
from minidual.trials.lessons.mating_script import MatingScript, record
from minidual.trials.lessons.mating_worlds import MatingWorlds
from tests.support.mating_trunks import SIZE, TERMS, Played, PlayedTrunks

COLUMNS = mating_columns(TERMS)


def observed(actions: RelativePose, lag_m: float, guess: tuple[float, float]) -> np.ndarray:
    """Return the observation (1, k) of a part that lags behind the plan, and stands askew."""
    rows = np.zeros((1, SIZE), np.float32)
    units = np.array([0.006, 0.030, 0.006, 0.04, 0.04])
    rows[0, COLUMNS["value"]] = actions.value / units
    error = actions.value + np.array([0.0, lag_m, 0.0, 0.0, 0.0])
    rows[0, COLUMNS["error"]] = error / units
    rows[0, COLUMNS["askew_guess"]] = np.array(guess) / 0.04
    return rows


def values(lag_m: float, guess: tuple[float, float], actions_n: int) -> np.ndarray:
    """Return what the script has moved (actions, 5) after each action."""
    script = MatingScript(TERMS, 1)
    actions = RelativePose()
    rows = []
    for _ in range(actions_n):
        actions.begin(script.action(observed(actions, lag_m, guess))[0])
        rows.append(actions.value)
    return np.array(rows)


def test_both_parts_are_turned_by_what_the_gaps_tell() -> None:
    way = values(0.0, (0.03, -0.02), 40)
    assert np.allclose(way[3:, 3], 0.03, atol=1e-6)
    assert np.allclose(way[3:, 4], -0.02, atol=1e-6)
    assert np.allclose(way[:, :3], 0.0, atol=1e-6)


def test_a_part_that_is_stuck_is_drawn_back_and_turned_by_other_signs() -> None:
    way = values(0.012, (0.03, -0.01), 70)
    signs = np.sign(way[[15, 31, 47, 63], 3:]).astype(int).tolist()
    assert signs == [[1, -1], [-1, -1], [1, 1], [-1, 1]]
    assert way[21:22, 1] < -0.01
    assert np.allclose(way[[15, 31], 1], 0.0, atol=1e-6)


def test_the_part_that_is_more_askew_is_turned_first() -> None:
    way = values(0.012, (0.01, -0.03), 32)
    assert np.sign(way[[15, 31], 3:]).astype(int).tolist() == [[1, -1], [1, 1]]


def test_aligned_parts_are_pushed_straight_on() -> None:
    assert np.allclose(values(0.0, (0.0, 0.0), 40), 0.0, atol=1e-6)


def test_successful_episodes_are_recorded_without_the_noise() -> None:
    trunks = PlayedTrunks({1: Played(4, success=False)})
    worlds = MatingWorlds(trunks, ("clean", "clean"), "toy", TERMS, episodes=100)
    shown = record(worlds, TERMS, 2, stream(1, "toy"))
    assert shown.observations.shape == (6, SIZE)
    assert shown.observations[:, 0].tolist() == [0.0] * 6  # start 1 fails
    assert shown.actions.tolist() == np.zeros((6, 5)).tolist()


def test_nothing_is_recorded_of_failures() -> None:
    trunks = PlayedTrunks({0: Played(3, success=False)})
    worlds = MatingWorlds(trunks, ("clean",), "toy", TERMS, episodes=100)
    shown = record(worlds, TERMS, 2, stream(1, "toy"))
    assert shown.observations.shape == (0, SIZE)
    assert shown.actions.shape == (0, 5)
