"""Batches side by side are one batch: each keeps its own worlds, and what has ended is told in order."""

from __future__ import annotations

import numpy as np

from minidual.policies.rl.beside import Beside
from minidual.policies.rl.lesson import WorldsWanted
from tests.support.rl_toy import STEP_M, STEPS_MAX, Points


def points(worlds_n: int, seed: int) -> Points:
    return Points(WorldsWanted(worlds_n, seed, "x", 0.0))


def test_each_part_gets_its_own_actions_and_gives_its_own_results() -> None:
    joined = Beside([points(2, 1), points(3, 2)])
    alone = [points(2, 1), points(3, 2)]
    first = joined.reset()[0]
    assert np.array_equal(first, np.concatenate([part.reset()[0] for part in alone]))
    actions = np.linspace(-1.0, 1.0, 5)[:, None]
    observations, rewards, terminated, truncated, infos = joined.step(actions)
    own = [alone[0].step(actions[:2]), alone[1].step(actions[2:])]
    for place, values in enumerate((observations, rewards, terminated, truncated)):
        assert np.array_equal(values, np.concatenate([step[place] for step in own]))
    last = np.concatenate([step[4]["final_obs"] for step in own])
    assert np.array_equal(infos["final_obs"], last)
    moved = infos["final_obs"][:, 1] - first[:, 1]
    assert np.allclose(moved, STEP_M * actions[:, 0], atol=1e-6)


def test_successes_of_both_parts_are_told() -> None:
    class Silent(Points):
        """Tells of ended episodes only where one has ended, as Gymnasium allows."""

        def step(self, actions):
            *values, infos = super().step(actions)
            ended = values[2].any() or values[3].any()
            return *values, infos if ended else {}

    wanted = WorldsWanted(2, 1, "x", 0.0)
    joined = Beside([Silent(wanted), points(2, 2)])
    joined.reset()
    for _ in range(STEPS_MAX):
        _, _, terminated, _, infos = joined.step(np.zeros((4, 1)))
        assert infos["final_info"]["success"].shape == (4,)
        assert np.array_equal(infos["final_info"]["success"], terminated)
