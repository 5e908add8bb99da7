"""The training loop: same seed same weights, interrupted or not; clear errors; checkpoints that LeRobot reads."""

from __future__ import annotations

import dataclasses
import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from minidual import emergency
from minidual.cli.app import run_command_line
from minidual.config.learning import TrainConfig
from minidual.demos.lerobot_reader import camera_key
from minidual.errors import DataError, EnvironmentMissingError, UsageError
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.kinds import POLICIES, Training, TrainResult, write_loss_csv
from minidual.show.figures.training import draw_loss
from minidual.stages.registry import STAGES, TOOLS
from tests.policies.test_demonstrations import tiny
from tests.support.late import late

torch = late("torch")
act = late("minidual.policies.act")
tensor_files = late("safetensors.torch")
batches = late("minidual.policies.batches")
pytestmark = pytest.mark.torch

SMALL = {
    "chunk_size": 10,
    "dim_model": 32,
    "dim_feedforward": 64,
    "heads": 4,
    "encoder_layers": 1,
    "keypoints": 8,
    "batch_size": 4,
    "steps": 4,
    "threads": 1,
    "log_every_steps": 2,
    "validate_every_steps": 2,
}


def train(
    demos: Demonstrations,
    config: TrainConfig,
    seed: int,
    folder: Path,
    **options: Any,
) -> TrainResult:
    return POLICIES[config.policy].train(Training(demos, config, seed, **options), folder)


@pytest.fixture(scope="module")
def demos() -> Demonstrations:
    return tiny()


def weights(checkpoint: Path) -> dict[str, torch.Tensor]:
    return tensor_files.load_file(checkpoint / "model.safetensors")


def same(a: dict[str, torch.Tensor], b: dict[str, torch.Tensor]) -> bool:
    return a.keys() == b.keys() and all(torch.equal(a[key], b[key]) for key in a)


def test_the_same_seed_gives_the_same_weights_and_another_seed_does_not(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    config = TrainConfig(**SMALL, dropout=0.1)
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        torch.manual_seed(hash(name) % 1000)  # the generator outside must not matter
        train(demos, config, seed, tmp_path / name)
    assert same(weights(tmp_path / "a"), weights(tmp_path / "b"))
    assert not same(weights(tmp_path / "a"), weights(tmp_path / "c"))


def test_training_leaves_the_torch_generator_and_threads_alone(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    torch.manual_seed(1)
    expected = torch.rand(3)
    torch.manual_seed(1)
    threads = torch.get_num_threads()
    train(demos, TrainConfig(**SMALL), 0, tmp_path / "a")
    assert torch.equal(torch.rand(3), expected)
    assert torch.get_num_threads() == threads


@pytest.mark.parametrize("stop_at", [2, 3])
def test_an_interrupted_training_goes_on_to_the_same_weights(
    demos: Demonstrations,
    tmp_path: Path,
    stop_at: int,
) -> None:
    config = TrainConfig(**SMALL, dropout=0.1)
    whole = train(demos, config, 5, tmp_path / "whole")
    done = 0

    def interrupt(steps: int, _loss: float) -> None:
        nonlocal done
        done += steps
        if done == stop_at:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(demos, config, 5, tmp_path / "cut", progress=tmp_path / "progress", advance=interrupt)
    assert not (tmp_path / "cut").exists()
    told: list[int] = []
    resumed = train(
        demos,
        config,
        5,
        tmp_path / "cut",
        progress=tmp_path / "progress",
        advance=lambda steps, _: told.append(steps),
    )
    assert resumed.resumed_from_step == told[0] == stop_at
    assert sum(told) == whole.steps
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "cut"))
    assert resumed.curve == whole.curve


def interrupt(_steps: int, _loss: float) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize("change", ["seed", "config", "data"])
def test_progress_of_another_training_is_not_used(
    demos: Demonstrations,
    tmp_path: Path,
    change: str,
) -> None:
    config = TrainConfig(**SMALL)
    seed = 5
    with pytest.raises(KeyboardInterrupt):
        train(
            demos,
            config,
            seed,
            tmp_path / "cut",
            progress=tmp_path / "progress",
            advance=interrupt,
        )
    if change == "seed":
        seed = 6
    elif change == "config":
        config = TrainConfig(**{**SMALL, "approach_weight": 1.0})
    else:
        demos = tiny(seed=1)
    before = (tmp_path / "progress").read_bytes()
    result = train(demos, config, seed, tmp_path / "cut", progress=tmp_path / "progress")
    assert result.resumed_from_step == 0
    assert result.set_aside is not None
    assert result.set_aside.parent == tmp_path / "set-aside"
    assert result.set_aside.name.startswith("train-act.other-progress-")
    assert result.set_aside.read_bytes() == before


def test_an_interrupted_training_says_where_the_one_before_is_and_that_goes_on(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    """It was lost: the second Ctrl-C replaced its progress."""
    config = TrainConfig(**SMALL)
    progress = tmp_path / "progress"
    train(demos, config, 5, tmp_path / "whole")
    for learning_rate in (config.learning_rate, 0.1):
        changed = TrainConfig(**{**SMALL, "learning_rate": learning_rate})
        with pytest.raises(KeyboardInterrupt) as caught:
            train(demos, changed, 5, tmp_path / "cut", progress=progress, advance=interrupt)
    (moved,) = (tmp_path / "set-aside").iterdir()
    assert str(caught.value) == f"interrupted; an earlier training's progress is in {moved}"
    moved.replace(progress)
    assert train(demos, config, 5, tmp_path / "cut", progress=progress).resumed_from_step == 1
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "cut"))


def test_settings_without_influence_on_the_weights_do_not_end_a_training(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    config = TrainConfig(**SMALL, dropout=0.1)
    free = {
        "seeds_n": 3,
        "log_every_steps": 1,
        "validate_every_steps": 1,
        "checkpoint_every_steps": 1,
    }
    changed = TrainConfig(
        **{**SMALL, **free, "time_limit_s": 900.0, "loss_ratio_max": 0.9},
        dropout=0.1,
    )
    train(demos, config, 5, tmp_path / "whole")
    train(demos, changed, 5, tmp_path / "changed")
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "changed"))
    with pytest.raises(KeyboardInterrupt):
        train(demos, config, 5, tmp_path / "cut", progress=tmp_path / "progress", advance=interrupt)
    result = train(demos, changed, 5, tmp_path / "cut", progress=tmp_path / "progress")
    assert (result.resumed_from_step, result.set_aside) == (1, None)
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "cut"))


def test_the_emergency_stop_ends_a_training_which_goes_on_later(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    """It trained to the end, and the finished training was thrown away."""
    config = TrainConfig(**SMALL)
    whole = train(demos, config, 5, tmp_path / "whole")
    try:
        with pytest.raises(emergency.EmergencyStop):
            train(
                demos,
                config,
                5,
                tmp_path / "cut",
                progress=tmp_path / "progress",
                advance=lambda *_: emergency.press("test"),
            )
    finally:
        emergency.release()
    assert not (tmp_path / "cut").exists()
    resumed = train(demos, config, 5, tmp_path / "cut", progress=tmp_path / "progress")
    assert (resumed.resumed_from_step, resumed.curve) == (1, whole.curve)
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "cut"))


def at_call(count: int, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function`, interrupted after its `count`-th call."""
    calls = iter(range(count, -1, -1))

    def interrupted(*args: Any, **options: Any) -> Any:
        result = function(*args, **options)
        if next(calls, 0) == 1:
            raise KeyboardInterrupt
        return result

    return interrupted


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("predict_action_chunk", 1),  # validation after step 2: the average is in the policy
        ("LossRow", 1),  # step 2 is not in the curve yet
        ("step", 3),  # step 3 is applied and not counted
        ("get_ema_multi_avg_fn", 3),
    ],
)
def test_an_interruption_within_a_step_leaves_the_progress_of_a_whole_one(
    demos: Demonstrations,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    count: int,
) -> None:
    """The progress held the averaged weights, or those of a step that was done again."""
    from minidual.policies import optimiser
    from minidual.policies import train as loop
    from minidual.policies.spatial_act.modeling_spatial_act import SpatialActPolicy

    config = TrainConfig(**SMALL, checkpoint_every_steps=2)
    whole = train(demos, config, 5, tmp_path / "whole")
    place = {
        "predict_action_chunk": SpatialActPolicy,
        "LossRow": loop,
        "step": torch.optim.AdamW,
        "get_ema_multi_avg_fn": optimiser,
    }[name]
    with monkeypatch.context() as patch:
        patch.setattr(place, name, at_call(count, getattr(place, name)))
        with pytest.raises(KeyboardInterrupt):
            train(demos, config, 5, tmp_path / "cut", progress=tmp_path / "progress")
    resumed = train(demos, config, 5, tmp_path / "cut", progress=tmp_path / "progress")
    assert resumed.resumed_from_step == 2
    assert resumed.curve == whole.curve
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "cut"))


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def other_keys(path: Path) -> None:
    torch.save({"fingerprint": "?"}, path)


def flipped(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize(
    "damage",
    [
        truncated,
        other_keys,
        flipped,
        a_folder,
        lambda path: path.write_bytes(b""),
        lambda p: p.write_text("\xff"),
    ],
)
def test_damaged_progress_is_set_aside_and_training_starts_anew(
    demos: Demonstrations,
    tmp_path: Path,
    damage: Callable[[Path], Any],
) -> None:
    """It ended with KeyError, IndexError or UnicodeDecodeError, each time that the command was typed."""
    config = TrainConfig(**SMALL)
    folder = tmp_path / ".train-act.progress"
    with pytest.raises(KeyboardInterrupt):
        train(demos, config, 5, tmp_path / "cut", progress=folder, advance=interrupt)
    damage(folder)
    result = train(demos, config, 5, tmp_path / "cut", progress=folder)
    assert (result.resumed_from_step, result.steps) == (0, config.steps)
    assert result.set_aside is not None
    assert result.set_aside.parent == tmp_path / "set-aside"
    assert result.set_aside.name.startswith("train-act.damaged-progress-")
    assert result.set_aside.exists()


def test_a_loss_that_is_not_finite_stops_with_the_step_and_the_learning_rate(
    demos: Demonstrations,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from minidual.policies.spatial_act.modeling_spatial_act import SpatialActPolicy

    forward = SpatialActPolicy.forward
    calls = 0

    def diverge(
        self: SpatialActPolicy,
        batch: dict[str, torch.Tensor],
    ) -> tuple[torch.Tensor, dict[str, float]]:
        nonlocal calls
        calls += 1
        loss, parts = forward(self, batch)
        return (loss * torch.inf if calls == 3 else loss), parts

    monkeypatch.setattr(SpatialActPolicy, "forward", diverge)
    with pytest.raises(UsageError, match="loss became inf at step 2") as caught:
        train(demos, TrainConfig(**SMALL), 0, tmp_path / "a")
    assert "train.learning_rate=" in str(caught.value.remedy)
    assert not (tmp_path / "a").exists()


def test_the_time_limit_cuts_training_and_says_so(demos: Demonstrations, tmp_path: Path) -> None:
    result = train(
        demos,
        TrainConfig(**{**SMALL, "steps": 400, "time_limit_s": 0.05}),
        0,
        tmp_path / "a",
    )
    assert result.stopped_by == "time limit"
    assert 0 < result.steps < 400 == result.steps_asked


def test_the_configured_learning_rate_is_what_the_curve_shows(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    config = TrainConfig(**{**SMALL, "steps": 40, "warmup_fraction": 0.1})
    rates = [row.learning_rate for row in train(demos, config, 0, tmp_path / "a").curve]
    assert max(rates) == pytest.approx(config.learning_rate, rel=0.01)
    assert rates[-1] < 0.02 * config.learning_rate
    assert rates.index(max(rates)) <= 2


def test_stock_resnet_act_loads_with_plain_lerobot(demos: Demonstrations, tmp_path: Path) -> None:
    from lerobot.policies.act.modeling_act import ACTPolicy

    config = TrainConfig(**{**SMALL, "policy": "act", "steps": 2, "use_vae": True})
    result = train(demos, config, 0, tmp_path / "a")
    assert result.parameters > 11e6
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

    train(demos, TrainConfig(**SMALL), 0, tmp_path / "a")
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
    from minidual.config.seeds import stream
    from minidual.policies.demonstrations import split_episodes

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
def test_a_missing_device_is_told_before_the_first_stage(words, tmp_path, capsys) -> None:
    """It was told by the fifth stage, after ten minutes of other work."""
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


def test_records_hold_the_curve(demos: Demonstrations, tmp_path: Path) -> None:
    result: TrainResult = train(demos, TrainConfig(**SMALL), 0, tmp_path / "a")
    write_loss_csv(result.curve, tmp_path / "loss.csv")
    lines = (tmp_path / "loss.csv").read_text().splitlines()
    assert lines[0].startswith("step,loss,l1,keyframe")
    assert [line.split(",")[0] for line in lines[1:]] == ["2", "4"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        draw_loss(result, tmp_path / "loss.png")
    assert (tmp_path / "loss.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    "bad",
    [
        {"dim_model": 64, "heads": 7},
        {"learning_rate": 0.0},
        {"learning_rate": float("nan")},
        {"policy": ""},
        {"steps": 0},
        {"unknown": 1},
    ],
)
def test_impossible_settings_are_refused(bad: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        TrainConfig(**bad)  # type: ignore[arg-type]


def test_a_policy_runs_in_the_precision_it_was_trained_in(
    demos: Demonstrations,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where the processor has it: emulated, bfloat16 would be slow."""
    monkeypatch.setattr("minidual.policies.act.native_bf16", lambda device: True)
    train(demos, TrainConfig(**SMALL), 0, tmp_path / "a")
    for native in (True, False):
        monkeypatch.setattr(
            "minidual.policies.act.native_bf16",
            lambda device, native=native: native,
        )
        policy = act.SPATIAL_ACT.read(tmp_path / "a").policy
        assert [encoder.bf16 for encoder in policy.model.backbone.encoders] == [native]


def test_a_prediction_ends_training_once(
    demos: Demonstrations,
    tmp_path: Path,
    monkeypatch,
) -> None:
    """Before, each inference visited every module to say so again: a tenth of its time."""
    train(demos, TrainConfig(**SMALL), 0, tmp_path / "a")
    policy = act.SPATIAL_ACT.read(tmp_path / "a").policy
    said = []
    batch = {
        "observation.state": torch.zeros(1, 16),
        "observation.images.cam_high": torch.zeros(1, 3, 12, 16),
    }
    policy.train()
    chunk = policy.predict_action_chunk(batch)
    assert not any(module.training for module in policy.modules())
    monkeypatch.setattr(torch.nn.Module, "train", lambda module, mode=True: said.append(mode))
    policy.reset()
    assert torch.equal(policy.predict_action_chunk(batch), chunk)
    assert said == []


def test_a_keyframe_is_the_mean_of_the_looks_until_it_is_past(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    train(demos, TrainConfig(**SMALL), 0, tmp_path / "a")
    policy = act.SPATIAL_ACT.read(tmp_path / "a").policy
    looks: list[Any] = []

    def look(picture: float, opening: float) -> Any:
        """Return (mean of the looks, this look), both (1, K, A)."""
        state = torch.zeros(1, 16)
        state[:, -2:] = opening  # [standard deviations]
        torch.manual_seed(int(picture))
        batch = {
            "observation.state": state,
            "observation.images.cam_high": torch.randn(1, 3, 12, 16),
        }
        handle = policy.model.register_forward_hook(lambda module, given, out: looks.append(out[2]))
        policy.predict_action_chunk(batch)
        handle.remove()
        return looks[-1], policy.model(batch)[2]

    first, alone = look(1, 0.9)
    assert torch.equal(first, alone)
    assert first.shape[1] == demos.keyframe_ticks.shape[1] > 1
    second, other = look(2, 0.8)
    assert (other - alone).abs().max() > 1e-4
    assert torch.allclose(second, (alone + other) / 2)
    switched, third = look(3, -0.9)
    assert third[:, 0].any()
    assert not switched[:, 0].any()  # the grasp is past
    assert torch.allclose(
        switched[:, 1:],
        ((alone + other + third) / 3)[:, 1:],
        atol=1e-6,
    )  # what is to come is not
    policy.reset()
    again, fourth = look(4, -0.9)
    assert torch.allclose(again, fourth)


def test_in_training_the_transformer_is_told_the_keyframes_to_come(
    demos: Demonstrations,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("minidual.policies.spatial_act.modeling_spatial_act._BEGINS_BETWEEN", 0.0)
    config = TrainConfig(**SMALL)
    torch.manual_seed(0)
    policy = act.SPATIAL_ACT.make(config, demos)
    stats = batches.dataset_statistics(demos, np.arange(len(demos)), config.std_floor)
    batch = batches.BatchMaker(demos, config, stats).clean(
        np.array([5, 30, 55]),
    )  # before, between and after two switches

    def moved(coming: bool) -> list[bool]:
        """Whether other keyframes change the actions of each row."""
        other = batch["keyframe"] + (batch["keyframe_is_valid"] == coming).unsqueeze(-1)
        return [
            bool(row.any())
            for row in policy.model(batch)[0] != policy.model({**batch, "keyframe": other})[0]
        ]

    policy.train()
    assert moved(True) == [True, True, False]
    assert moved(False) == [False] * 3
    policy.eval()
    assert moved(True) == [False] * 3


@pytest.mark.parametrize(("share", "read"), [(0.0, [False] * 3), (1.0, [False, True, True])])
def test_past_keyframes_are_told_as_0_but_in_a_share_of_the_samples(
    demos: Demonstrations,
    monkeypatch: pytest.MonkeyPatch,
    share: float,
    read: list[bool],
) -> None:
    """Else the end of a task, whose keyframes are past, may look like the start of its mirror image."""
    monkeypatch.setattr("minidual.policies.spatial_act.modeling_spatial_act._BEGINS_BETWEEN", share)
    config = TrainConfig(**SMALL, dropout=0.0)
    torch.manual_seed(0)
    policy = act.SPATIAL_ACT.make(config, demos)
    policy.train()
    stats = batches.dataset_statistics(demos, np.arange(len(demos)), config.std_floor)
    batch = batches.BatchMaker(demos, config, stats).clean(np.array([5, 30, 55]))
    other = policy.model({**batch, camera_key("high"): -batch[camera_key("high")]})[0]
    assert [bool(row.any()) for row in policy.model(batch)[0] != other] == read


def _policy_and_batch(demos: Demonstrations) -> tuple[Any, dict[str, torch.Tensor]]:
    config = TrainConfig(**SMALL)
    torch.manual_seed(0)
    policy = act.SPATIAL_ACT.make(config, demos)
    policy.train()
    stats = batches.dataset_statistics(demos, np.arange(len(demos)), config.std_floor)
    return policy, batches.BatchMaker(demos, config, stats).clean(np.array([5, 30]))


def _reads(policy: Any) -> list[bool]:
    return [
        bool(p.grad is not None and p.grad.any())
        for p in policy.model.backbone.encoders.parameters()
    ]


def test_keyframes_alone_train_what_reads_the_pictures(demos: Demonstrations) -> None:
    policy, batch = _policy_and_batch(demos)
    actions, _, keyframe = policy.model(batch)
    actions.sum().backward()
    assert not any(_reads(policy))
    assert policy.model.backbone.linear.weight.grad is None
    keyframe.sum().backward()
    assert all(_reads(policy))


def test_told_all_keyframes_the_transformer_sees_nothing_of_the_pictures(
    demos: Demonstrations,
) -> None:
    policy, batch = _policy_and_batch(demos)
    batch["keyframe_is_valid"][:] = True
    actions, _, keyframe = policy.model(batch)
    other, _, moved = policy.model({**batch, camera_key("high"): -batch[camera_key("high")]})
    assert not torch.equal(keyframe, moved)
    assert torch.equal(actions, other)


def test_without_keyframes_the_actions_train_it(demos: Demonstrations) -> None:
    action = demos.action.copy()
    action[:, -2:] = 1.0
    policy, batch = _policy_and_batch(dataclasses.replace(demos, action=action))
    assert policy.model.backbone.shape[0] == 0
    policy(batch)[0].backward()
    assert all(_reads(policy))


def test_what_reads_the_pictures_has_its_own_learning_rate(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    for rate in (1e-3, 1e-2):
        train(
            demos,
            TrainConfig(**(SMALL | {"steps": 1, "backbone_learning_rate": rate})),
            0,
            tmp_path / f"{rate}",
        )
    slow, fast = (weights(tmp_path / f"{rate}") for rate in (1e-3, 1e-2))
    differ = {name for name, values in slow.items() if not torch.equal(values, fast[name])}
    assert differ
    assert all(name.startswith("model.backbone.") for name in differ)
