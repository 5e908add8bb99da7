"""PPO after cloning: the value learns first and at a rate of its own, the policy stays near what it copied."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.root import Config, changed
from tests.support.late import late
from tests.support.rl_toy import ToyLesson

torch = late("torch")
training = late("minidual.policies.rl.training")
vector_env = late("minidual.policies.rl.vector_env")
lessons = late("minidual.policies.rl.lesson")
pytestmark = pytest.mark.torch

ACTIONS_OF_UPDATE = 8 * 16


def begun(folder: Path, **values: Any) -> Any:
    """Return a training of the toy that has copied its demonstrations."""
    settings = {
        "worlds_n": 8,
        "rollout": 16,
        "hidden": 16,
        "batch_size": 128,
        "demonstrations_n": 20,
        "validation_starts": 0,
        "value_warmup": 2,
        **values,
    }
    config = changed(Config(), {f"methods.rl.{name}": value for name, value in settings.items()})
    job = training.RlJob(config, ToyLesson(), 7, folder / "progress", lambda steps, note: None)
    wanted = lessons.WorldsWanted(8, 7, training.TRAINING, 0.0)
    made = training.Training(job, vector_env.SteppedWorlds(job.lesson.worlds(config, wanted)))
    made.model.clone(200)
    return made


def parameters(model: Any) -> tuple[Any, Any]:
    """Return copies of the policy's and the value's parameters, each as one vector."""
    groups = model.policy.optimizer.param_groups
    acting, judging = (
        np.concatenate([one.detach().numpy().ravel().copy() for one in group["params"]])
        for group in groups
    )
    return acting, judging


def test_every_parameter_is_in_one_of_the_groups(tmp_path: Path) -> None:
    model = begun(tmp_path).model
    grouped = [id(one) for group in model.policy.optimizer.param_groups for one in group["params"]]
    assert sorted(grouped) == sorted(id(one) for one in model.policy.parameters())


def test_the_value_learns_alone_at_first(tmp_path: Path) -> None:
    model = begun(tmp_path, value_warmup=2).model
    acting, judging = parameters(model)
    model.learn(2 * ACTIONS_OF_UPDATE)
    acting_then, judging_then = parameters(model)
    assert np.array_equal(acting, acting_then)
    assert not np.array_equal(judging, judging_then)
    model.learn(3 * ACTIONS_OF_UPDATE)
    assert not np.array_equal(acting_then, parameters(model)[0])


def test_the_value_has_a_rate_of_its_own(tmp_path: Path) -> None:
    model = begun(tmp_path, value_warmup=0, learning_rate=1e-12, value_rate=1e-2).model
    model.clone_weight = 0.0
    acting, judging = parameters(model)
    model.learn(ACTIONS_OF_UPDATE)
    acting_then, judging_then = parameters(model)
    assert np.abs(acting_then - acting).max() < 1e-9
    assert np.abs(judging_then - judging).max() > 1e-3


def test_more_epochs_while_only_the_value_learns_fit_it_better(tmp_path: Path) -> None:
    def error(epochs: int) -> float:
        model = begun(tmp_path, value_warmup=10, value_epochs=epochs).model
        model.learn(4 * ACTIONS_OF_UPDATE)
        buffer = model.rollout_buffer
        return float(np.mean((buffer.returns - buffer.values) ** 2))

    assert error(20) < 0.5 * error(1)
