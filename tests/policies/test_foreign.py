"""Checkpoints of stock LeRobot policies drive our arms, and what cannot be loaded is named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.learning import DeployConfig
from minidual.errors import DataError, EnvironmentMissingError, UsageError
from minidual.policies.facts import Place
from minidual.policies.kinds import load_policy
from minidual.policies.pilot import load_runtime
from minidual.robot.pair import DUAL_PANDA
from tests.support.late import late

torch = late("torch")
configs = late("lerobot.configs")
factory = late("lerobot.policies.factory")
foreign = late("minidual.policies.foreign")

pytestmark = pytest.mark.torch
PLACE = Place((96, 128), 50.0)
STATE = np.r_[DUAL_PANDA.home, 1.0, 1.0]
IMAGES = {"high": np.zeros((96, 128, 3), np.uint8)}
ACT = {
    "chunk_size": 30,
    "n_action_steps": 30,
    "dim_model": 64,
    "n_heads": 4,
    "dim_feedforward": 64,
    "n_encoder_layers": 1,
    "use_vae": False,
    "pretrained_backbone_weights": None,
}
VQBET = {
    "n_obs_steps": 2,
    "n_action_pred_token": 2,
    "action_chunk_size": 3,
    "crop_shape": (84, 84),
    "pretrained_backbone_weights": None,
    "gpt_n_layer": 1,
    "gpt_n_head": 2,
    "gpt_hidden_dim": 32,
    "gpt_output_dim": 32,
    "vqvae_enc_hidden_dim": 16,
    "vqvae_n_embed": 4,
    "vqvae_embedding_dim": 16,
}


def saved(folder: Path, kind: str, settings: dict[str, Any], camera: str = "high") -> Path:
    """Save a new stock policy as `lerobot-train` does, with statistics of arms at home."""
    visual = configs.FeatureType.VISUAL
    feature = configs.PolicyFeature
    inputs = {
        "observation.state": feature(type=configs.FeatureType.STATE, shape=(16,)),
        f"observation.images.{camera}": feature(type=visual, shape=(3, 96, 128)),
    }
    config = factory.make_policy_config(
        kind,
        input_features=inputs,
        output_features={"action": feature(type=configs.FeatureType.ACTION, shape=(16,))},
        device="cpu",
        push_to_hub=False,
        **settings,
    )
    torch.manual_seed(0)
    policy = factory.get_policy_class(kind)(config)
    home = torch.tensor(STATE, dtype=torch.float32)
    numbers = {
        "mean": home,
        "std": torch.full((16,), 0.01),
        "min": home - 0.01,
        "max": home + 0.01,
    }
    pixel = torch.full((3, 1, 1), 0.5)
    pixels = {"mean": pixel, "std": pixel, "min": 0.0 * pixel, "max": 2.0 * pixel}
    stats = {"observation.state": numbers, "action": numbers}
    stats[f"observation.images.{camera}"] = pixels
    for part in (policy, *factory.make_pre_post_processors(config, dataset_stats=stats)):
        part.save_pretrained(folder)
    return folder


@pytest.fixture(scope="module")
def act(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return saved(tmp_path_factory.mktemp("act"), "act", ACT)


@pytest.fixture(scope="module")
def vqbet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return saved(tmp_path_factory.mktemp("vqbet"), "vqbet", VQBET)


def test_a_stock_act_answers_in_chunks(act: Path) -> None:
    """Its camera "observation.images.high" is our `high`."""
    runtime = load_runtime(act, DeployConfig(), DUAL_PANDA, PLACE)
    assert runtime.policy.chunk_size == 30
    action = runtime.act(IMAGES, STATE)
    assert np.abs(action[:14] - STATE[:14]).max() < 0.2


def test_a_policy_that_looks_back_keeps_its_own_pace(vqbet: Path) -> None:
    runtime = load_runtime(vqbet, DeployConfig(), DUAL_PANDA, PLACE)
    assert runtime.policy.own_pace
    actions = [runtime.act(IMAGES, STATE) for _ in range(4)]
    assert len(runtime.times_s) == 4, "it looks at every tick"
    assert np.isfinite(actions).all()
    runtime.reset()
    runtime.policy.instruct("any")


def test_more_steps_than_a_chunk_has_are_refused_with_a_remedy(act: Path) -> None:
    with pytest.raises(UsageError, match=r"(?s)outside 1\.\.30.*deploy.n_action_steps=30"):
        load_runtime(act, DeployConfig(n_action_steps=40), DUAL_PANDA, PLACE)


def test_a_camera_of_another_name_is_named(tmp_path: Path) -> None:
    folder = saved(tmp_path / "act", "act", ACT, camera="top")
    with pytest.raises(UsageError, match=r"it reads a camera 'observation\.images\.top'"):
        load_runtime(folder, DeployConfig(), DUAL_PANDA, PLACE)


def test_a_missing_statistic_is_named(act: Path, tmp_path: Path) -> None:
    """LeRobot would leave the numbers as they are."""
    from safetensors.torch import load_file, save_file

    folder = tmp_path / "act"
    folder.mkdir()
    for path in act.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    for path in folder.glob("policy_*.safetensors"):
        tensors = load_file(path)
        kept = {name: values for name, values in tensors.items() if "state" not in name}
        save_file(kept, path)
    with pytest.raises(UsageError, match=r"need the statistic 'observation\.state\.mean'"):
        load_runtime(folder, DeployConfig(), DUAL_PANDA, PLACE)


def test_a_type_that_lerobot_does_not_know_is_named(tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text('{"type": "difusion"}')
    with pytest.raises(DataError, match=r"(?s)no policy 'difusion'.*did you mean 'diffusion'"):
        load_policy(tmp_path)


def test_what_a_checkpoint_lacks_is_named(tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text('{"type": "vqbet"}')
    with pytest.raises(DataError, match=r"lacks model.safetensors, policy_preprocessor.json"):
        load_policy(tmp_path)


def test_a_step_that_runs_other_code_is_refused(vqbet: Path, tmp_path: Path) -> None:
    for path in vqbet.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    processor = tmp_path / "policy_preprocessor.json"
    record = json.loads(processor.read_text())
    record["steps"][0] = {"class": "os.system", "config": {}}
    processor.write_text(json.dumps(record))
    with pytest.raises(DataError, match="minidual runs only"):
        load_policy(tmp_path)


def test_a_library_that_is_missing_is_named(
    vqbet: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def missing(name: str) -> None:
        raise ImportError("'diffusers' is required")

    monkeypatch.setattr("minidual.policies.foreign.get_policy_class", missing)
    with pytest.raises(EnvironmentMissingError, match="needs a library that is not installed"):
        load_policy(vqbet)


def test_they_are_not_trained_here() -> None:
    with pytest.raises(UsageError, match="trained by lerobot-train"):
        foreign.FOREIGN.train(None, Path())
