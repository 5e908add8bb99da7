"""The plug-ins of `plugins/`: names and options that LeRobot reads, without its commands."""

from __future__ import annotations

import importlib.util
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from minidual.errors import UsageError
from tests.support.late import late
from tests.support.lerobot_env import PLUGINS, ROOT

torch = late("torch")
utils = late("lerobot.envs.utils")
configs = late("lerobot.configs")
factory = late("lerobot.policies.factory")
envs = late("lerobot.envs")
robots = late("lerobot.robots")
teleoperators = late("lerobot.teleoperators")

PREFIXES = ("lerobot_robot_", "lerobot_teleoperator_", "lerobot_env_", "lerobot_policy_")
pytestmark = pytest.mark.torch


@pytest.fixture(autouse=True)
def on_the_path(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for plugin in PLUGINS:
        monkeypatch.syspath_prepend(str(plugin))
    monkeypatch.setenv("HF_LEROBOT_HOME", str(tmp_path))


@pytest.mark.parametrize("plugin", PLUGINS, ids=lambda path: path.name)
def test_each_distribution_has_the_name_by_which_lerobot_imports_it(plugin: Path) -> None:
    project = tomllib.loads((plugin / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["name"] == plugin.name
    assert plugin.name.startswith(PREFIXES)
    assert (plugin / plugin.name / "__init__.py").is_file()
    assert set(project["dependencies"]) == {"lerobot>=0.6.1,<0.7", "minidual"}


def test_there_is_one_of_each_kind() -> None:
    kinds = [next(p for p in PREFIXES if plugin.name.startswith(p)) for plugin in PLUGINS]
    assert sorted(kinds) == sorted(PREFIXES)


def test_lerobot_makes_the_robot_from_its_options() -> None:
    import lerobot_robot_minidual

    config = lerobot_robot_minidual.BiMinidualConfig(views=["high", "left"], task="handover")
    assert config.type == "bi_minidual"
    robot = robots.make_robot_from_config(config)
    assert next(iter(robot.action_features)) == "left_panda_joint1.pos"
    assert robot.observation_features["cam_left"] == (96, 192, 3)
    assert len(robot.cameras) == 2
    assert robot.is_calibrated
    assert not robot.is_connected


def test_lerobot_makes_the_teleoperator_from_its_options() -> None:
    import lerobot_robot_minidual
    import lerobot_teleoperator_minidual

    config = lerobot_teleoperator_minidual.MinidualLeaderConfig(
        leader="network",
        settings={"teleop.network.port": 0},
    )
    assert config.type == "minidual_leader"
    leader = teleoperators.make_teleoperator_from_config(config)
    robot = robots.make_robot_from_config(lerobot_robot_minidual.BiMinidualConfig())
    assert leader.action_features == robot.action_features
    robot.arms.close()  # else the leader would ask where these arms are
    leader.connect()
    assert leader.is_connected
    assert set(leader.get_action()) == set(robot.action_features)
    leader.disconnect()


def test_an_unknown_name_is_said_through_lerobot() -> None:
    import lerobot_robot_minidual

    config = lerobot_robot_minidual.BiMinidualConfig(task="rod")
    with pytest.raises(ValueError, match="no task 'rod'"):
        robots.make_robot_from_config(config)


def test_the_policy_of_a_checkpoint_loads_in_plain_lerobot() -> None:
    import lerobot_policy_minidual  # noqa: F401

    folder = ROOT / "src" / "minidual" / "policies" / "shipped" / "act" / "rod_carry"
    config = configs.PreTrainedConfig.from_pretrained(folder)
    assert config.type == "spatial_act"
    policy = factory.get_policy_class("spatial_act").from_pretrained(folder, config=config)
    pre, post = factory.make_pre_post_processors(
        config,
        pretrained_path=str(folder),
        preprocessor_overrides={"device_processor": {"device": "cpu"}},
    )
    batch = pre(
        {
            "observation.state": torch.zeros(16),
            "observation.images.cam_high": torch.zeros(3, 96, 128),
        },
    )
    action = post(policy.select_action(batch))
    assert tuple(action.shape) == (1, 16)
    assert bool(torch.isfinite(action).all())


def test_a_training_of_lerobot_leaves_out_keyframes_for_which_it_has_no_labels() -> None:
    import lerobot_policy_minidual

    config = lerobot_policy_minidual.SpatialActConfig()
    assert config.keyframes == 0


def test_the_weights_of_a_new_policy_can_be_saved_with_an_optimiser_s_state() -> None:
    """safetensors refuses what is not contiguous."""
    import lerobot_policy_minidual  # noqa: F401

    folder = ROOT / "src" / "minidual" / "policies" / "shipped" / "act" / "rod_carry"
    config = configs.PreTrainedConfig.from_pretrained(folder)
    policy = factory.get_policy_class("spatial_act")(config)
    assert all(parameter.is_contiguous() for parameter in policy.parameters())
    policy.fast_on_cpu()
    assert not all(parameter.is_contiguous() for parameter in policy.parameters())


def test_all_tasks_are_environments_of_one_configuration() -> None:
    import lerobot_env_minidual

    config = lerobot_env_minidual.MinidualEnv(
        task="all",
        views=["high", "right"],
        settings={"scene.camera.width_px": 192},
    )
    assert config.type == "minidual"
    assert len(config.tasks) == 5
    features = utils.env_to_policy_features(config)
    assert features["observation.images.cam_right"].shape == (3, 96, 192)
    assert features["observation.state"].shape == (16,)
    assert features["action"].shape == (16,)


def test_tasks_with_pictures_of_several_sizes_need_one() -> None:
    import lerobot_env_minidual

    with pytest.raises(UsageError, match="rod_carry 128 x 96"):
        lerobot_env_minidual.MinidualEnv(task="all")
    assert lerobot_env_minidual.MinidualEnv(task="all", views=[]).features_map["action"] == "action"


def test_the_end_of_an_episode_is_reported_in_its_own_step_and_a_finished_world_rests() -> None:
    """A world that ends first is not played again while the others go on."""
    import lerobot_env_minidual

    config = lerobot_env_minidual.MinidualEnv(
        views=[],
        settings={"scene.task.time_limit_s": 1.5},
    )
    vector = config.create_envs(2, use_async_envs=False)["rod_carry"][0]
    try:
        observation, _ = vector.reset(seed=[1, 2], options={"lerobot_new_rollout": True})
        assert vector.call("_max_episode_steps") == (75, 75)
        assert vector.call("task_description")[0]
        action = np.c_[observation["agent_pos"][:, :-2], np.ones((2, 2))].astype(np.float32)
        for _ in range(74):
            _, _, _, truncated, info = vector.step(action)
            assert not truncated.any()
        _, _, _, truncated, info = vector.step(action)
        assert truncated.all()
        assert list(info["final_info"]["is_success"]) == [False, False]
        ended_s = info["final_info"]["time_s"]
        _, reward, _, truncated, info = vector.step(action)
        assert truncated.all()
        assert list(reward) == [0.0, 0.0]
        assert list(info["final_info"]["time_s"]) == list(ended_s)
    finally:
        vector.close()


def test_the_file_of_envhub_makes_what_lerobot_asks_for() -> None:
    from lerobot.envs.utils import _call_make_env, _import_hub_module, _normalize_hub_result

    path = ROOT / "plugins" / "lerobot_env_minidual" / "env.py"
    module = _import_hub_module(str(path), "minidual/tasks")
    made = _normalize_hub_result(_call_make_env(module, 1, False, None))
    try:
        assert list(made) == ["rod_carry"]
        assert made["rod_carry"][0].num_envs == 1
    finally:
        utils.close_envs(made)
        sys.modules.pop("hub_env_minidual_tasks", None)
    assert importlib.util.find_spec("lerobot_env_minidual") is not None
