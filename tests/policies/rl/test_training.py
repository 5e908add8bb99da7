"""A training by reinforcement: it learns, clones, goes on after a kill, and keeps the best policy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual import emergency
from minidual.config.root import Config, changed
from minidual.errors import DataError, UsageError
from tests.support.late import late
from tests.support.rl_toy import Points, ToyLesson

training = late("minidual.policies.rl.training")
lessons = late("minidual.policies.rl.lesson")
vector_env = late("minidual.policies.rl.vector_env")
networks = late("minidual.policies.rl.network")
pytestmark = pytest.mark.torch

QUICK = {
    "methods.rl.steps": 1024,
    "methods.rl.worlds_n": 8,
    "methods.rl.rollout": 16,
    "methods.rl.hidden": 16,
    "methods.rl.demonstrations_n": 0,
    "methods.rl.clone_steps": 300,
    "methods.rl.validation_starts": 16,
    "methods.rl.validate_every_updates": 2,
    "methods.rl.batch_size": 128,
    "methods.rl.learning_rate": 3e-3,
    "methods.rl.deviation": 0.5,
}


def job(folder: Path, lesson: Any = None, advance: Any = None, **values: Any) -> Any:
    settings = {**QUICK, **{f"methods.rl.{name}": value for name, value in values.items()}}
    return training.RlJob(
        changed(Config(), settings),
        lesson or ToyLesson(),
        7,
        folder / "progress",
        advance or (lambda steps, note: None),
    )


def weights(network: Any) -> list[Any]:
    return [*network.layers.weights, *network.layers.biases]


def test_it_learns_from_scratch(tmp_path: Path) -> None:
    result = training.train_rl(job(tmp_path, steps=6144))
    untrained = training.train_rl(job(tmp_path, steps=1, learning_rate=1e-9))
    assert result.validation_rate > 0.9
    assert untrained.validation_rate < 0.6
    assert result.steps >= 6144
    assert result.demonstrations_n == 0


def test_demonstrations_are_copied_before_the_first_update(tmp_path: Path) -> None:
    result = training.train_rl(job(tmp_path, demonstrations_n=20))
    assert result.demonstrations_n == 400
    assert result.curve[0]["step"] == 0
    assert result.curve[0]["validation_success_rate"] > 0.9


def test_a_lesson_without_demonstrations_is_learned_from_scratch(tmp_path: Path) -> None:
    result = training.train_rl(job(tmp_path, ToyLesson(shown=False), demonstrations_n=20))
    assert result.demonstrations_n == 0


def test_the_best_policy_of_the_validation_is_kept(tmp_path: Path) -> None:
    result = training.train_rl(job(tmp_path, demonstrations_n=20))
    assert result.validation_rate == max(row["validation_success_rate"] for row in result.curve)
    again = training.validation_rate(job(tmp_path), result.network)
    assert again == result.validation_rate


def test_equal_jobs_give_equal_networks_and_other_seeds_others(tmp_path: Path) -> None:
    first = training.train_rl(job(tmp_path))
    second = training.train_rl(job(tmp_path))
    other = training.train_rl(job(tmp_path)._replace(seed=8))
    pairs = zip(weights(first.network), weights(second.network), strict=True)
    assert all(np.array_equal(a, b) for a, b in pairs)
    assert not np.array_equal(weights(first.network)[0], weights(other.network)[0])


def test_a_stopped_training_goes_on(tmp_path: Path) -> None:
    steps_done = [0]

    def stop(steps: int, note: str) -> None:
        steps_done[0] += steps
        if steps_done[0] >= 768:
            raise emergency.EmergencyStop

    with pytest.raises(emergency.EmergencyStop):
        training.train_rl(job(tmp_path, advance=stop))
    assert (tmp_path / "progress").is_file()
    result = training.train_rl(job(tmp_path))
    assert 0 < result.resumed_from < 1024
    assert result.steps >= 1024
    assert not (tmp_path / "progress").exists()


def test_progress_of_another_training_is_set_aside(tmp_path: Path) -> None:
    def stop(steps: int, note: str) -> None:
        if steps:
            stops.append(steps)
        if len(stops) == 6:
            raise emergency.EmergencyStop

    stops: list[int] = []
    with pytest.raises(emergency.EmergencyStop):
        training.train_rl(job(tmp_path, advance=stop))
    result = training.train_rl(job(tmp_path, discount=0.9))
    assert result.resumed_from == 0
    assert list((tmp_path / "set-aside").iterdir())


def test_a_reward_that_is_not_finite_is_an_error(tmp_path: Path) -> None:
    class Broken(Points):
        def step(self, actions: Any) -> Any:
            observations, rewards, *rest = super().step(actions)
            return observations, rewards * np.nan, *rest

    class BrokenLesson(ToyLesson):
        def worlds(self, config: Any, wanted: Any) -> Points:
            return Broken(wanted)

    with pytest.raises(DataError, match="reward that is not finite"):
        training.train_rl(job(tmp_path, BrokenLesson()))


def test_a_policy_that_diverged_is_an_error(tmp_path: Path) -> None:
    worlds = vector_env.SteppedWorlds(Points(lessons.WorldsWanted(8, 7, "x", 0.0)))
    broken = training.Training(job(tmp_path), worlds)
    broken.model.policy.action_net.bias.data.fill_(float("nan"))
    with pytest.raises(DataError, match="diverged"):
        broken.network()


def test_worlds_that_reset_in_another_way_are_refused() -> None:
    class Late(Points):
        metadata = {"autoreset_mode": None}  # noqa: RUF012

    wanted = lessons.WorldsWanted(2, 7, "x", 0.0)
    with pytest.raises(UsageError, match="SAME_STEP"):
        vector_env.SteppedWorlds(Late(wanted))
