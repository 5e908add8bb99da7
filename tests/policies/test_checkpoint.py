"""Loading a checkpoint: what it maps, and which files are refused before they act."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.learning import TrainConfig
from minidual.errors import DataError, EnvironmentMissingError, ExitCode
from minidual.policies.kinds import POLICIES, Training
from minidual.policies.policy import PolicyRuntime
from tests.support.late import late
from tests.support.training_samples import SMALL, tiny

torch = late("torch")
tensor_files = late("safetensors.torch")
pytestmark = pytest.mark.torch


IMAGE = {"high": np.zeros((12, 16, 3), np.uint8)}
STATE = np.zeros(16)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("policy") / "checkpoint"
    POLICIES["spatial_act"].train(Training(tiny(), TrainConfig(**SMALL), 0), folder)
    return folder


def test_a_checkpoint_drives_and_repeats(checkpoint: Path) -> None:
    demos = tiny()
    runtime = PolicyRuntime.load(checkpoint, n_action_steps=5)
    assert runtime.cameras == {"high": (12, 16)}
    actions = []
    for _ in range(2):
        runtime.reset()
        observed = zip(demos.images["high"][:8], demos.state[:8], strict=True)
        actions.append(np.array([runtime.act({"high": i}, s) for i, s in observed]))
    assert actions[0].shape == (8, 16)
    assert np.array_equal(actions[0], actions[1])


def test_the_image_and_the_state_both_matter(checkpoint: Path) -> None:
    runtime = PolicyRuntime.load(checkpoint, n_action_steps=5)
    dark = runtime.predict_chunk(IMAGE, STATE)
    noise = {"high": np.random.default_rng(0).integers(0, 256, (12, 16, 3), dtype=np.uint8)}
    assert np.abs(runtime.predict_chunk(noise, STATE) - dark).max() > 1e-6
    assert np.abs(runtime.predict_chunk(IMAGE, STATE + 0.3) - dark).max() > 1e-6


@pytest.mark.parametrize(
    "name",
    ["config.json", "model.safetensors", "policy_preprocessor.json", "policy_postprocessor.json"],
)
def test_a_missing_file_is_named_with_the_command_that_makes_it(
    checkpoint: Path,
    tmp_path: Path,
    name: str,
) -> None:
    copy = shutil.copytree(checkpoint, tmp_path / "copy")
    (copy / name).unlink()
    with pytest.raises(DataError, match=re.escape(name)) as caught:
        PolicyRuntime.load(copy)
    assert "minidual train-act" in str(caught.value.remedy)


def test_a_missing_checkpoint_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"no checkpoint folder .*nowhere") as caught:
        PolicyRuntime.load(tmp_path / "nowhere")
    assert caught.value.remedy == "minidual train-act"


@pytest.mark.parametrize(
    "damage",
    [
        "truncated weights",
        "text for weights",
        "text for config",
        "other type",
        "unknown key",
        "other shape",
        "no stats",
    ],
)
def test_a_corrupt_checkpoint_is_refused(checkpoint: Path, tmp_path: Path, damage: str) -> None:
    copy = shutil.copytree(checkpoint, tmp_path / "copy")
    weights = copy / "model.safetensors"
    config = copy / "config.json"
    record = json.loads(config.read_text())
    if damage == "truncated weights":
        weights.write_bytes(weights.read_bytes()[:-500])
    elif damage == "text for weights":
        weights.write_text("not weights")
    elif damage == "text for config":
        config.write_text("{ not json")
    elif damage == "other type":
        config.write_text(json.dumps({**record, "type": "diffusion"}))
    elif damage == "unknown key":
        config.write_text(json.dumps({**record, "surprise": 1}))
    elif damage == "other shape":
        config.write_text(json.dumps({**record, "dim_model": 64}))
    else:
        for path in copy.glob("policy_preprocessor_*.safetensors"):
            path.unlink()
    with pytest.raises(DataError, match=r"checkpoint|config\.json"):
        PolicyRuntime.load(copy)


def test_loading_for_cuda_without_a_device_is_an_environment_error(checkpoint: Path) -> None:
    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device here")
    with pytest.raises(EnvironmentMissingError, match="no CUDA device"):
        PolicyRuntime.load(checkpoint, "cuda")


def changed_json(path: Path, change: Any) -> None:
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))


@pytest.mark.parametrize("name", ["policy_preprocessor.json", "policy_postprocessor.json"])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda step, path: step.update(
                {"class": "os.system", "config": {"command": f"touch {path}"}},
            ),
            "class",
        ),
        (
            lambda step, path: (step.clear(), step.update({"class": "os.system", "config": {}})),
            "class 'os.system'",
        ),
        (
            lambda step, path: step.update(registry_name="reward_classifier_processor"),
            "registry_name",
        ),
        (lambda step, path: step.update(state_file="../other.safetensors"), "Invalid name"),
        (lambda step, path: step.update(state_file="absent.safetensors"), "absent.safetensors"),
        (lambda step, path: step.update(state_file=3), "cannot be read"),
    ],
)
def test_a_processor_file_can_run_nothing_but_the_steps_of_act(
    checkpoint: Path,
    tmp_path: Path,
    name: str,
    change: Any,
    words: str,
) -> None:
    copy = shutil.copytree(checkpoint, tmp_path / "copy")
    changed_json(copy / name, lambda record: change(record["steps"][0], tmp_path / "ran"))
    with pytest.raises(DataError, match=words) as caught:
        PolicyRuntime.load(copy)
    assert caught.value.exit_code == ExitCode.USAGE
    assert caught.value.remedy
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("value", [np.nan, np.inf, "integers"])
@pytest.mark.parametrize(
    "pattern",
    ["model.safetensors", "policy_preprocessor_*", "policy_postprocessor_*"],
)
def test_weights_and_statistics_must_be_finite_numbers(
    checkpoint: Path,
    tmp_path: Path,
    pattern: str,
    value: float | str,
) -> None:
    copy = shutil.copytree(checkpoint, tmp_path / "copy")
    path = next(p for p in copy.glob(pattern) if p.suffix == ".safetensors")
    tensors = tensor_files.load_file(path)
    name = sorted(tensors)[-1]
    tensors[name] = (
        tensors[name].to(torch.int64) if value == "integers" else tensors[name].fill_(value)
    )
    tensor_files.save_file(tensors, path)
    with pytest.raises(DataError, match=f"{path.name}: '{name}'.*finite floating-point numbers"):
        PolicyRuntime.load(copy)


def test_statistics_of_another_shape_are_refused_before_the_arms_move(
    checkpoint: Path,
    tmp_path: Path,
) -> None:
    copy = shutil.copytree(checkpoint, tmp_path / "copy")
    path = next(copy.glob("policy_preprocessor_*.safetensors"))
    tensors = tensor_files.load_file(path)
    tensor_files.save_file({**tensors, "observation.state.mean": torch.zeros(9)}, path)
    with pytest.raises(DataError, match=r"cannot be read: .*9"):
        PolicyRuntime.load(copy)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c.update(dim_model=10**9), "dim_model"),
        (lambda c: c.update(n_encoder_layers=10**9), "n_encoder_layers"),
        (lambda c: c.update(chunk_size="many"), "many"),
        (
            lambda c: c["input_features"]["observation.images.cam_high"].update(
                shape=[3, 10**6, 10**6],
            ),
            "cam_high .* are 0 to 4096",
        ),
        (lambda c: c.update(type="act"), "another type|not valid"),
        (lambda c: c.update(input_features=None), "checkpoint"),
    ],
)
def test_a_configuration_that_asks_for_too_much_is_refused(
    checkpoint: Path,
    tmp_path: Path,
    change: Any,
    words: str,
) -> None:
    copy = shutil.copytree(checkpoint, tmp_path / "copy")
    changed_json(copy / "config.json", change)
    with pytest.raises(DataError, match=words):
        PolicyRuntime.load(copy)


def test_loading_a_checkpoint_leaves_no_temporary_file(
    checkpoint: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    PolicyRuntime.load(checkpoint, n_action_steps=5)
    assert list(tmp_path.iterdir()) == []
