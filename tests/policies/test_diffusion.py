"""LeRobot's diffusion policy: trained here, small, driven in chunks, the same for equal looks."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from minidual.config.learning import DeployConfig, TrainConfig
from minidual.errors import EnvironmentMissingError
from minidual.policies import kinds
from minidual.policies.demonstrations import Demonstrations
from minidual.policies.kinds import POLICIES, TrainResult, load_policy
from minidual.policies.pilot import load_runtime
from minidual.robot.pair import DUAL_PANDA
from tests.support.late import late
from tests.support.training_samples import SMALL, same, tiny, train, weights

torch = late("torch")
diffusion = late("minidual.policies.diffusion")
lerobot_policy = late("minidual.policies.lerobot_policy")
pytestmark = pytest.mark.torch

SETTINGS = {**SMALL, "policy": "diffusion", "steps": 3, "denoising_steps": 2, "threads": 2}
CHUNK = 12
"""Ticks: the 10 of SMALL, in whole multiples of four."""


@pytest.fixture(scope="module")
def demos() -> Demonstrations:
    """Of pictures whose feature maps have more than one place: else a resnet tells no place."""
    return tiny(size=(40, 48))


@pytest.fixture(scope="module")
def trained(
    demos: Demonstrations,
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Path, TrainResult]:
    folder = tmp_path_factory.mktemp("diffusion") / "a"
    return folder, train(demos, TrainConfig(**SETTINGS), 0, folder)


def test_it_trains_by_its_name_and_plain_lerobot_reads_it(
    trained: tuple[Path, TrainResult],
) -> None:
    from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy

    folder, result = trained
    assert (result.steps, result.steps_asked) == (3, 3)
    assert result.architecture == "diffusion"
    assert result.validation_l1 is not None
    assert 11e6 < result.parameters < 13e6
    record = json.loads((folder / "config.json").read_text())
    assert record["type"] == "diffusion"
    assert record["pretrained_backbone_weights"] is None, "nothing is to be downloaded"
    theirs = DiffusionPolicy.from_pretrained(folder)
    assert theirs.config.horizon == CHUNK
    assert theirs.diffusion.num_inference_steps == 2


def test_it_answers_in_chunks_and_equal_looks_have_equal_answers(
    demos: Demonstrations,
    trained: tuple[Path, TrainResult],
) -> None:
    runtime = load_runtime(trained[0], DeployConfig(n_action_steps=5), DUAL_PANDA)
    assert isinstance(runtime.policy, lerobot_policy.DenoisedChunkPolicy)
    assert not runtime.policy.own_pace
    images = {"high": demos.images["high"][7]}
    state = demos.state[7].astype(float)
    torch.manual_seed(1)
    chunk = runtime.predict_chunk(images, state)
    drawn = torch.rand(3)
    assert chunk.shape == (CHUNK, 16)
    torch.manual_seed(2)
    np.testing.assert_array_equal(runtime.predict_chunk(images, state), chunk)
    torch.manual_seed(1)
    assert torch.equal(torch.rand(3), drawn), "the generator outside is left alone"
    negative = {"high": 255 - images["high"]}
    assert np.abs(runtime.predict_chunk(negative, state) - chunk).max() > 1e-7
    assert np.abs(runtime.predict_chunk(images, state + 0.5) - chunk).max() > 1e-6


def test_the_checkpoint_answers_as_the_network_that_was_trained(
    demos: Demonstrations,
    trained: tuple[Path, TrainResult],
) -> None:
    """Its statistics normalise as training does."""
    policy = load_policy(trained[0], threads=1)
    network = policy._trained.policy
    ours = diffusion.OneLookDiffusion(network.config)
    ours.load_state_dict(network.state_dict())
    ours.eval()
    observation = {"observation.state": torch.from_numpy(demos.state[7])}
    image = torch.from_numpy(demos.images["high"][7]).permute(2, 0, 1) / 255.0
    observation["observation.images.cam_high"] = image
    batch = policy._trained.preprocessor(observation)
    chunk = policy._trained.postprocessor(ours.predict_action_chunk(batch))[0]
    answer = policy.predict({"high": demos.images["high"][7]}, demos.state[7])
    np.testing.assert_allclose(chunk.numpy(), answer, atol=1e-5)


def test_the_same_seed_gives_the_same_weights(
    demos: Demonstrations,
    trained: tuple[Path, TrainResult],
    tmp_path: Path,
) -> None:
    """Noise is drawn in the network itself, by one thread."""
    torch.manual_seed(9)
    train(demos, TrainConfig(**SETTINGS), 0, tmp_path / "b")
    assert same(weights(trained[0]), weights(tmp_path / "b"))


@pytest.fixture(scope="module")
def behind_eyes(
    demos: Demonstrations,
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Path, TrainResult]:
    """A checkpoint of LeRobot's UNet behind the eyes of `spatial_act`."""
    folder = tmp_path_factory.mktemp("spatial") / "a"
    settings = {**SETTINGS, "policy": "spatial_diffusion", "steps": 40}
    return folder, train(demos, TrainConfig(**settings), 0, folder)


def test_behind_keyframes_it_is_small_and_learns(
    demos: Demonstrations,
    behind_eyes: tuple[Path, TrainResult],
) -> None:
    folder, result = behind_eyes
    assert result.architecture == "keyframe_diffusion"
    assert result.parameters < 1e6
    assert result.loss_final < result.loss_initial
    assert result.validation_keyframe_rad is not None
    runtime = load_runtime(folder, DeployConfig(n_action_steps=5), DUAL_PANDA)
    images = {"high": demos.images["high"][7]}
    state = demos.state[7].astype(float)
    chunk = runtime.predict_chunk(images, state)
    assert chunk.shape == (10, 16)
    runtime.reset()
    np.testing.assert_array_equal(runtime.predict_chunk(images, state), chunk)
    runtime.reset()
    assert np.abs(runtime.predict_chunk(images, state + 0.5) - chunk).max() > 1e-6
    runtime.reset()
    dark = {"high": np.zeros_like(images["high"])}
    assert np.abs(runtime.predict_chunk(dark, state) - chunk).max() > 1e-6


def test_behind_keyframes_threads_share_a_batch_and_the_weights_stay_the_same(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    """Noise is drawn before the batch is shared."""
    settings = {**SETTINGS, "policy": "spatial_diffusion"}
    for outside, name in enumerate(("a", "b")):
        torch.manual_seed(outside)
        train(demos, TrainConfig(**settings), 0, tmp_path / name)
    assert same(weights(tmp_path / "a"), weights(tmp_path / "b"))


def test_its_first_pass_begins_at_pure_noise(behind_eyes: tuple[Path, TrainResult]) -> None:
    network = load_policy(behind_eyes[0], threads=1)._trained.policy
    scheduler = network.model.diffusion.noise_scheduler
    scheduler.set_timesteps(network.config.denoising_steps)
    assert scheduler.timesteps.tolist() == [99, 49]


@pytest.mark.parametrize("policy", ["diffusion", "spatial_diffusion"])
def test_without_its_library_it_is_refused_with_the_extra(
    policy: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(kinds, "find_spec", lambda name: None)
    with pytest.raises(EnvironmentMissingError, match="needs the library 'diffusers'") as missing:
        POLICIES[policy].require("cpu")
    assert missing.value.remedy == "pip install 'minidual[diffusion]'"
