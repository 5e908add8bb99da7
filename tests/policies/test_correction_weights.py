"""Training weights ticks by who drove."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from minidual.config.learning import TrainConfig
from minidual.errors import DataError
from minidual.policies.demonstrations import joined
from tests.support.late import late
from tests.support.training_samples import tiny

pytestmark = pytest.mark.torch
batches = late("minidual.policies.batches")


def test_corrections_weigh_more_and_the_policys_own_ticks_nothing() -> None:
    config = TrainConfig(correction_weight=5.0)
    weights = batches.driver_weights(np.array([0, 1, 2, 2]), config)
    assert weights.tolist() == [1.0, 0.0, 5.0, 5.0]


def test_ticks_of_the_policy_alone_are_refused() -> None:
    with pytest.raises(DataError, match="the policy drove all of them"):
        batches.driver_weights(np.ones(5, dtype=int), TrainConfig())


def test_batches_draw_no_tick_of_the_policy() -> None:
    demos = tiny()
    driver = np.zeros(len(demos), dtype=np.int64)
    driver[: len(demos) // 2] = 1
    drawn = batches.BatchStream(
        batches.BatchMaker(
            demos, TrainConfig(), batches.dataset_statistics(demos, np.arange(len(demos)), 0.01)
        ),
        replace(demos, driver=driver),
        np.arange(len(demos)),
        TrainConfig(),
        1,
    )
    probabilities = drawn._probabilities
    drawn.close()
    assert probabilities[: len(demos) // 2].sum() == 0.0
    assert probabilities.sum() == pytest.approx(1.0)


def test_datasets_are_joined_with_episodes_of_their_own() -> None:
    base = tiny(episodes=2)
    corrected = replace(tiny(episodes=1, seed=1), driver=np.full(60, 2, dtype=np.int64))
    both = joined([base, corrected])
    assert len(both) == 180
    assert np.unique(both.episode_index).tolist() == [0, 1, 2]
    assert both.driver is not None
    assert both.driver[:120].tolist() == [0] * 120
    assert both.driver[120:].tolist() == [2] * 60
    assert np.array_equal(both.images["high"][120:], corrected.images["high"])


def test_datasets_of_other_pictures_are_not_joined() -> None:
    with pytest.raises(DataError, match="camera 'high' has pictures of"):
        joined([tiny(), tiny(size=(10, 10))])
