"""Environments from Python."""

from __future__ import annotations

import pytest

from minidual.api.environments import make_env
from minidual.errors import UsageError


def test_an_environment_takes_settings_of_its_scene() -> None:
    env = make_env("pot_lift", object_pose=True, settings={"scene.task.time_limit_s": 1.1})
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    ended = [env.step(observation["state"])[3] for _ in range(55)]
    assert ended.index(True) == 54, "the time limit ends it"
    env.close()


def test_another_setting_is_refused() -> None:
    with pytest.raises(UsageError, match=r"no setting 'robot.arm'.*begin with 'scene\.'"):
        make_env(settings={"robot.arm": "xarm7"})


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(UsageError, match="pot_lift"):
        make_env("pot_lft")
