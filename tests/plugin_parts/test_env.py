"""The environment with LeRobot's names."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.errors import UsageError
from minidual.plugin_parts.env import EvaluatedTask
from minidual.tasks.catalogue import TASKS


@pytest.mark.parametrize("task", TASKS)
def test_each_task_says_what_it_is_and_how_long_it_lasts(task: str) -> None:
    env = EvaluatedTask(task, views=())
    try:
        assert env.task == task
        assert len(env.task_description) > 10
        assert env._max_episode_steps >= 500
        observation, info = env.reset(seed=1, options={"lerobot_new_rollout": True})
        assert env.observation_space.contains(observation)
        assert info["is_success"] is False
        action = np.r_[observation["agent_pos"][:-2], 1.0, 1.0].astype(np.float32)
        observation, _, _, _, info = env.step(action)
        assert env.observation_space.contains(observation)
        assert info == {"is_success": False, "time_s": pytest.approx(0.02)}
    finally:
        env.close()


def test_the_last_step_is_that_of_the_time_limit() -> None:
    env = EvaluatedTask(
        views=(),
        rate_hz=30.0,
        settings={"scene.task.time_limit_s": 2.0},
    )
    try:
        assert env._max_episode_steps == 60
        assert env.metadata["render_fps"] == 30
        observation, _ = env.reset(seed=1)
        action = np.r_[observation["agent_pos"][:-2], 1.0, 1.0].astype(np.float32)
        ends = [env.step(action)[3] for _ in range(60)]
        assert ends.index(True) == 59
    finally:
        env.close()


def test_pictures_have_the_names_of_our_datasets() -> None:
    env = EvaluatedTask(views=("high",), settings={"scene.camera.width_px": 64})
    try:
        observation, _ = env.reset(seed=1)
        assert list(observation["pixels"]) == ["cam_high"]
        assert observation["pixels"]["cam_high"].shape == (96, 64, 3)
        assert env.render().shape == (480, 640, 3)
    finally:
        env.close()


def test_wrong_names_and_rates_are_refused() -> None:
    with pytest.raises(UsageError, match="no task 'rod'"):
        EvaluatedTask("rod")
    with pytest.raises(UsageError, match="rate_hz is 500"):
        EvaluatedTask(rate_hz=500.0)
