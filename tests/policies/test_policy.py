"""The policy runtime: queue, blending, flush, clamps, and errors that name what is wrong."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.learning import TrainConfig
from minidual.errors import DataError, EnvironmentMissingError, ExitCode, UsageError
from minidual.policies.kinds import POLICIES, ChunkPolicy, Image, Training
from minidual.policies.policy import PolicyRuntime
from tests.policies.test_demonstrations import tiny
from tests.policies.test_train import SMALL
from tests.support.late import late

torch = late("torch")
tensor_files = late("safetensors.torch")
pytestmark = pytest.mark.torch

IMAGE = {"high": np.zeros((12, 16, 3), np.uint8)}
STATE = np.zeros(16)


class CountingPolicy(ChunkPolicy):
    """Emits chunk number n as n + k / 1000 for tick k, so that every action tells where it comes from."""

    def __init__(self, chunk: int, cameras: tuple[str, ...] = ("high",)) -> None:
        self.calls = 0
        self.seen: list[dict[str, Image]] = []
        self.resets = 0
        self.chunk_size = chunk
        self.dim = 16
        self.cameras = dict.fromkeys(cameras, (12, 16))

    def reset(self) -> None:
        self.resets += 1

    def predict(self, images: Mapping[str, Image], state: np.ndarray) -> np.ndarray:
        self.calls += 1
        self.seen.append(dict(images))
        return np.repeat(
            (self.calls + np.arange(self.chunk_size) / 1000)[:, None],
            self.dim,
            axis=1,
        )


def counting(chunk: int = 10, **options: Any) -> tuple[PolicyRuntime, CountingPolicy]:
    policy = CountingPolicy(chunk)
    return PolicyRuntime(policy, **{"n_action_steps": 5, "blend_ticks": 0, **options}), policy


def first(runtime: PolicyRuntime, ticks: int) -> list[float]:
    return [round(float(runtime.act(IMAGE, STATE)[0]), 6) for _ in range(ticks)]


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("policy") / "checkpoint"
    POLICIES["spatial_act"].train(Training(tiny(), TrainConfig(**SMALL), 0), folder)
    return folder


def test_a_chunk_runs_for_its_steps_and_then_the_next_is_inferred() -> None:
    runtime, policy = counting()
    assert first(runtime, 7) == pytest.approx(
        [1.0, 1.001, 1.002, 1.003, 1.004, 2.0, 2.001],
        abs=1e-6,
    )
    assert policy.calls == 2


def test_after_a_reset_nothing_of_the_old_chunk_runs() -> None:
    runtime, _ = counting(blend_ticks=4)
    first(runtime, 2)
    runtime.reset()
    assert first(runtime, 5) == pytest.approx(
        [2.0, 2.001, 2.002, 2.003, 2.004],
        abs=1e-6,
    )  # no blend with chunk 1


def test_chunks_are_blended_with_what_was_left_of_the_old_one() -> None:
    runtime, _ = counting(blend_ticks=3)
    actions = first(runtime, 10)
    old = [1.005, 1.006, 1.007]
    expected = [
        (1 - s) * o + s * (2 + k / 1000)
        for k, (o, s) in enumerate(zip(old, (0.25, 0.5, 0.75), strict=True))
    ]
    assert actions[5:8] == pytest.approx(expected, abs=1e-6)
    assert actions[8:] == pytest.approx([2.003, 2.004], abs=1e-6)


def test_blending_without_overlap_starts_from_the_last_action() -> None:
    runtime, _ = counting(chunk=5, blend_ticks=2)
    assert first(runtime, 7)[5] == pytest.approx((1.004 * 2 + 2.0) / 3, abs=1e-6)


def test_blending_shrinks_the_jump_at_the_boundary() -> None:
    jumps = []
    for ticks in (0, 8):
        runtime, _ = counting(chunk=50, n_action_steps=25, blend_ticks=ticks)
        jumps.append(np.abs(np.diff(first(runtime, 60))).max())
    assert jumps[1] < 0.2 * jumps[0]


def test_actions_are_clamped_to_the_limits() -> None:
    upper = np.full(14, 1.002)
    runtime, _ = counting(limits=(np.full(14, -1.0), upper))
    actions = np.array([runtime.act(IMAGE, STATE) for _ in range(5)])
    assert actions[:, :14].max() == pytest.approx(1.002)
    assert actions[:, 14:].max() == 1.0  # an opening has limits of its own


def test_pictures_are_rendered_only_when_they_are_looked_at() -> None:
    runtime, _ = counting()
    rendered = 0

    def camera() -> np.ndarray:
        nonlocal rendered
        rendered += 1
        return IMAGE["high"]

    for _ in range(12):
        runtime.act({"high": camera}, STATE)
    assert rendered == 3


def test_timing_counts_inferences_only() -> None:
    runtime, _ = counting()
    first(runtime, 12)
    assert len(runtime.times_s) == 3
    assert runtime.inference_hz == pytest.approx(1 / np.mean(runtime.times_s[1:]))


def test_wrong_observations_are_refused() -> None:
    runtime, _ = counting()
    with pytest.raises(DataError, match=r"no image of camera 'high'.*given were left"):
        runtime.act({"left": IMAGE["high"]}, STATE)
    with pytest.raises(DataError, match=r"shape \(24, 32, 3\).*trained on uint8 \(12, 16, 3\)"):
        runtime.act({"high": np.zeros((24, 32, 3), np.uint8)}, STATE)
    with pytest.raises(DataError, match="float64 images"):
        runtime.act({"high": np.zeros((12, 16, 3))}, STATE)
    with pytest.raises(DataError, match=r"state has shape \(14,\)"):
        runtime.act(IMAGE, np.zeros(14))
    with pytest.raises(DataError, match="not finite at index 3"):
        runtime.act(IMAGE, np.where(np.arange(16) == 3, np.nan, 0.0))


def test_an_action_that_is_not_finite_never_leaves() -> None:
    runtime, policy = counting()
    policy.predict = lambda images, state: np.full((10, 16), np.nan)  # type: ignore[method-assign]
    with pytest.raises(DataError, match="emitted an action that is not finite"):
        runtime.act(IMAGE, STATE)


def test_impossible_queues_and_limits_are_refused() -> None:
    with pytest.raises(UsageError, match=r"n_action_steps 11 is outside 1\.\.10"):
        counting(n_action_steps=11)
    with pytest.raises(UsageError, match="drives 14 joints; the limits are"):
        counting(limits=(np.zeros(7), np.ones(7)))
    with pytest.raises(UsageError, match="drives 14 joints") as caught:
        counting(limits=(np.zeros(12), np.ones(12)))
    assert "robot.arm" in str(caught.value.remedy)


def test_cameras_keep_the_order_of_training_whatever_the_order_given() -> None:
    policy = CountingPolicy(10, cameras=("high", "left"))
    runtime = PolicyRuntime(policy, n_action_steps=1)
    bright = np.full((12, 16, 3), 255, np.uint8)
    runtime.act({"left": bright, "right": bright, "high": IMAGE["high"]}, STATE)
    assert list(policy.seen[0]) == ["high", "left"]
    assert policy.seen[0]["left"].min() == 255
    assert policy.seen[0]["high"].max() == 0


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


def test_cuda_without_a_device_is_an_environment_error(checkpoint: Path) -> None:
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


def test_a_reset_reaches_the_policy() -> None:
    runtime, policy = counting()
    before = policy.resets
    first(runtime, 12)
    assert policy.resets == before
    runtime.reset()
    assert policy.resets == before + 1
