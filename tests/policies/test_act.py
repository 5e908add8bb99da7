"""Checkpoints of ACT policies: plain LeRobot reads them, at the precision and on the device of the machine."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from minidual.cli.app import run_command_line
from minidual.config.learning import TrainConfig
from minidual.config.seeds import stream
from minidual.errors import DataError, EnvironmentMissingError
from minidual.policies.demonstrations import Demonstrations, split_episodes
from minidual.stages.registry import STAGES, TOOLS
from tests.support.late import late
from tests.support.training_samples import SMALL, tiny, train

torch = late("torch")
act = late("minidual.policies.act")
tensor_files = late("safetensors.torch")
batches = late("minidual.policies.batches")
pytestmark = pytest.mark.torch


@pytest.fixture(scope="module")
def demos() -> Demonstrations:
    return tiny()


def test_stock_resnet_act_loads_with_plain_lerobot(demos: Demonstrations, tmp_path: Path) -> None:
    from lerobot.policies.act.modeling_act import ACTPolicy

    config = TrainConfig(**{**SMALL, "policy": "act", "steps": 2, "use_vae": True})
    result = train(demos, config, 0, tmp_path / "a")
    assert result.parameters > 11e6
    assert result.architecture == "stock_act"
    assert json.loads((tmp_path / "a" / "config.json").read_text())["type"] == "act"
    theirs = ACTPolicy.from_pretrained(tmp_path / "a")
    ours = act.ACT_KIND.read(tmp_path / "a").policy
    batch = {
        "observation.state": torch.zeros(1, 16),
        "observation.images.cam_high": torch.zeros(1, 3, 12, 16),
    }
    assert torch.equal(
        theirs.predict_action_chunk(dict(batch)),
        ours.predict_action_chunk(dict(batch)),
    )


def test_spatial_checkpoint_is_labelled_and_lerobot_reads_it(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    from lerobot.configs import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    result = train(demos, TrainConfig(**SMALL), 0, tmp_path / "a")
    assert result.architecture == "keyframe_act"
    record = json.loads((tmp_path / "a" / "config.json").read_text())
    assert record["type"] == "spatial_act"
    assert record["pretrained_backbone_weights"] is None, "nothing is to be downloaded"
    names = tensor_files.load_file(tmp_path / "a" / "model.safetensors")
    assert any(name.startswith("model.backbone.encoders.0.features") for name in names)
    assert not any(
        "layer" in name.removeprefix("model.backbone.") for name in names if ".backbone." in name
    ), "a resnet"
    config = PreTrainedConfig.from_pretrained(tmp_path / "a")
    policy = get_policy_class(config.type).from_pretrained(
        tmp_path / "a",
        config=config,
        strict=True,
    )
    pre, post = make_pre_post_processors(config, pretrained_path=str(tmp_path / "a"))
    image = torch.from_numpy(demos.images["high"][7]).permute(2, 0, 1) / 255.0
    batch = pre(
        {
            "observation.state": torch.from_numpy(demos.state[7]),
            "observation.images.cam_high": image,
        },
    )
    assert post(policy.select_action(batch)).shape == (1, 16)


def test_processors_of_the_checkpoint_normalise_as_training_does(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:

    config = TrainConfig(**SMALL)
    train(demos, config, 0, tmp_path / "a")
    _, pre, post = act.SPATIAL_ACT.read(tmp_path / "a")
    episodes, _ = split_episodes([0, 1, 2], config.validation_fraction, stream(0, "train.split"))
    stats = batches.dataset_statistics(demos, demos.rows_of(episodes), config.std_floor)
    trained_on = batches.BatchMaker(demos, config, stats).clean(np.array([33]))
    image = torch.from_numpy(demos.images["high"][33]).permute(2, 0, 1) / 255.0
    seen = pre(
        {
            "observation.state": torch.from_numpy(demos.state[33]),
            "observation.images.cam_high": image,
        },
    )
    for key in ("observation.state", "observation.images.cam_high"):
        assert torch.allclose(seen[key], trained_on[key], atol=1e-5)
    assert torch.allclose(
        post(trained_on["action"])[0],
        torch.from_numpy(demos.action[33:43]),
        atol=1e-5,
    )


def test_precision_follows_what_the_processor_computes_natively() -> None:
    # These names are torch's public account of the processor; without them "auto" would silently be float32.
    capabilities = torch.cpu.get_capabilities()
    if capabilities["architecture"] == "x86_64":
        assert {"avx512_bf16", "amx_tile"} <= capabilities.keys()
    native = bool(capabilities.get("avx512_bf16") or capabilities.get("amx_tile"))
    assert act.native_bf16("cpu") is native


def test_a_policy_runs_in_the_precision_it_was_trained_in(
    demos: Demonstrations,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In bfloat16 only where the processor has it: emulated, it would be slow."""
    monkeypatch.setattr("minidual.policies.act.native_bf16", lambda device: True)
    train(demos, TrainConfig(**SMALL), 0, tmp_path / "a")
    for native in (True, False):
        monkeypatch.setattr(
            "minidual.policies.act.native_bf16",
            lambda device, native=native: native,
        )
        policy = act.SPATIAL_ACT.read(tmp_path / "a").policy
        assert [encoder.bf16 for encoder in policy.model.backbone.encoders] == [native]


def test_cuda_without_a_device_is_an_environment_error(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device here")
    with pytest.raises(EnvironmentMissingError, match="finds no CUDA device"):
        train(demos, TrainConfig(**{**SMALL, "device": "cuda"}), 0, tmp_path / "a")


@pytest.mark.parametrize(
    "words",
    [["--set", "train.device=cuda"], ["--set", "deploy.device=cuda"], ["--profile=gpu"]],
)
def test_a_missing_device_is_told_before_the_first_stage(
    words: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device here")
    assert (
        run_command_line(["run", *words, "--runs-dir", str(tmp_path / "runs")], STAGES, TOOLS) == 4
    )
    assert "finds no CUDA device" in capsys.readouterr().err
    assert list((tmp_path / "runs").glob("*/*")) == []
    assert (
        run_command_line(
            ["config", "show", *words, "--runs-dir", str(tmp_path / "runs")],
            STAGES,
            TOOLS,
        )
        == 0
    )


def test_an_existing_checkpoint_is_not_overwritten(demos: Demonstrations, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    with pytest.raises(DataError, match="exists already"):
        train(demos, TrainConfig(**SMALL), 0, tmp_path / "a")
