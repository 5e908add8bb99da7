"""The policy spatial_act: keypoints to a fraction of a pixel, keyframes as the transformer gets them."""

from __future__ import annotations

import dataclasses
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.learning import TrainConfig
from minidual.demos.lerobot_reader import camera_key
from minidual.policies.architectures import KEYFRAME_ACT, KEYPOINT_ACT
from minidual.policies.demonstrations import Demonstrations
from tests.support.late import late
from tests.support.training_samples import SMALL, tiny, train

torch = late("torch")
act = late("minidual.policies.act")
batches = late("minidual.policies.batches")
shares = late("minidual.policies.shares")

backbone = late("minidual.policies.spatial_act.modeling_spatial_act")
pytestmark = pytest.mark.torch


@pytest.fixture(scope="module")
def demos() -> Demonstrations:
    return tiny()


@pytest.mark.parametrize(("row", "column"), [(0, 0), (23, 31), (11, 7)])
def test_a_sharp_peak_gives_its_pixel_centre(row: int, column: int) -> None:
    pool = backbone.SpatialSoftmax(2)
    logits = torch.full((3, 2, 24, 32), 0.0)
    logits[:, 1, row, column] = 60.0
    x, y, spread = pool(logits)[:, [1, 3, 5]].unbind(1)
    assert torch.allclose(x, torch.tensor((column + 0.5) / 16 - 1), atol=1e-5)
    assert torch.allclose(y, torch.tensor((row + 0.5) / 12 - 1), atol=1e-5)
    assert torch.all(spread < 0.01)


def test_a_flat_map_says_that_it_found_nothing() -> None:
    flat = backbone.SpatialSoftmax(1)(torch.zeros(1, 1, 24, 32))[0].detach()
    assert flat[:2].abs().max() < 1e-6
    assert flat[2] == pytest.approx(
        (1 / 3 + 1 / 3) ** 0.5,
        rel=0.01,
    )  # two uniform variables on [-1, 1]


def test_a_blob_between_pixels_is_found_between_pixels() -> None:
    rows, columns = torch.meshgrid(torch.arange(24.0), torch.arange(32.0), indexing="ij")
    centre = torch.tensor([10.3, 20.7])
    logits = -((rows - centre[0]) ** 2 + (columns - centre[1]) ** 2)
    x, y, _ = backbone.SpatialSoftmax(1)(logits[None, None])[0].detach()
    assert (x + 1) * 16 - 0.5 == pytest.approx(20.7, abs=0.01)
    assert (y + 1) * 12 - 0.5 == pytest.approx(10.3, abs=0.01)


def test_moving_the_picture_moves_the_keypoints() -> None:
    torch.manual_seed(0)
    encoder = backbone.KeypointEncoder(8)
    encoder.pool.log_inverse_temperature.data.fill_(3.0)  # sharp maps, as after training
    blob = torch.zeros(1, 3, 96, 128)
    blob[:, :, 40:46, 50:56] = 2.0
    moved = torch.roll(blob, shifts=8, dims=3)
    keypoints = encoder(torch.cat([blob, moved]))[:, :8].detach()
    follow = (keypoints[1] - keypoints[0]) * 64
    assert follow.max() == pytest.approx(8.0, abs=1.5)


def test_bfloat16_convolutions_leave_coordinates_in_float32() -> None:
    torch.manual_seed(0)
    encoder = backbone.KeypointEncoder(8)
    image = torch.randn(2, 3, 96, 128)
    exact = encoder(image)
    encoder.bf16 = True
    rounded = encoder(image)
    assert rounded.dtype == torch.float32
    assert (rounded - exact).abs().max() < 0.02


def test_context_widens_what_a_feature_sees() -> None:
    """The pixels on which the middle of the maps depends, by automatic differentiation."""
    torch.manual_seed(0)
    encoder = backbone.KeypointEncoder(4)
    for convolved, seen in ((encoder.features, 21), (encoder.maps, 81)):
        image = torch.randn(1, 3, 128, 128, requires_grad=True)
        convolved(image)[0, :, 16, 16].sum().backward()
        columns = image.grad.abs().sum((0, 1, 2)).nonzero()
        assert columns.max() - columns.min() + 1 == pytest.approx(
            seen,
            abs=4,
        )  # some weights are 0 by chance


def test_keypoints_do_not_depend_on_the_light_of_the_maps() -> None:
    torch.manual_seed(0)
    image = torch.randn(2, 3, 96, 128)
    encoder = backbone.KeypointEncoder(8)
    before = encoder(image)
    maps = encoder.maps(image)
    encoder.heads.weight.data.mul_(3.0)
    encoder.heads.bias.data.add_(1.0)
    assert (encoder.maps(image) - maps).abs().max() > 1.0
    assert (encoder(image) - before).abs().max() < 1e-3


@pytest.mark.parametrize("octaves", [0, 3])
def test_waves_keep_the_keypoints_and_turn_with_their_places(octaves: int) -> None:
    waves = backbone.PlaceWaves(keypoints=2, cameras_n=1, octaves=octaves)
    x, y = 0.25, -0.5
    keypoints = torch.tensor([[x, 0.0, y, 0.0, 0.1, 0.2]])  # two x, two y, two spreads
    features = waves(keypoints)
    assert features.shape == (1, waves.dim)
    assert torch.equal(features[:, :6], keypoints)
    sines, cosines = features[0, 6:].unflatten(0, (2, 4 * octaves)) if octaves else ([], [])
    for octave in range(octaves):
        for place, value in ((0, x), (2, y)):
            angle = np.pi * 2**octave * value
            assert float(sines[place * octaves + octave]) == pytest.approx(np.sin(angle), abs=1e-6)
            assert float(cosines[place * octaves + octave]) == pytest.approx(
                np.cos(angle), abs=1e-6
            )


def _error_at_either_end(octaves: int) -> float:
    """Return the error of a head in what depends on the place of an object, of its largest value.

    The object stands at the left or at the right end of the picture, and there within a tenth.
    """
    generator = torch.Generator().manual_seed(4)
    torch.manual_seed(4)
    waves = backbone.PlaceWaves(keypoints=2, cameras_n=1, octaves=octaves)
    linear = torch.nn.Linear(waves.dim, 4)
    hidden = torch.nn.Sequential(
        torch.nn.Linear(waves.dim, 64), torch.nn.ReLU(), torch.nn.Linear(64, 4)
    )
    parameters = [*linear.parameters(), *hidden.parameters()]
    optimiser = torch.optim.AdamW(parameters, lr=2.5e-3)
    slower = torch.optim.lr_scheduler.MultiStepLR(optimiser, [400], gamma=0.1)
    for _ in range(600):
        right = (torch.rand(32, 1, generator=generator) < 0.5).float()
        moved = 0.1 * (2.0 * torch.rand(32, 2, generator=generator) - 1.0)
        places = moved + torch.cat([1.6 * right - 0.8, torch.zeros_like(right)], dim=1)
        keypoints = torch.cat([places[:, :1], places[:, :1], places[:, 1:], places[:, 1:]], dim=1)
        features = waves(torch.cat([keypoints, torch.zeros(32, 2)], dim=1))
        # Each arm goes to the object on its side, and otherwise stays where it is.
        target = torch.cat([moved * right, moved * (1.0 - right)], dim=1)
        error = (linear(features) + hidden(features) - target).abs().mean()
        optimiser.zero_grad()
        error.backward()
        optimiser.step()
        slower.step()
    return float(error.detach()) / 0.1


def test_a_head_learns_centimetres_at_either_end_of_the_picture() -> None:
    """What a handover asks of it, and what it hardly learns of the places alone."""
    assert _error_at_either_end(octaves=3) < 0.05
    assert _error_at_either_end(octaves=0) > 0.07


def test_the_settings_make_the_head_and_a_checkpoint_keeps_them(
    demos: Demonstrations,
    tmp_path: Path,
) -> None:
    plain = _policy(demos).model.backbone
    assert plain.linear.in_features == plain.keypoint_dim
    policy = _policy(demos, octaves=3, head_width=24)
    head = policy.model.backbone.hidden
    assert head[0].in_features == plain.keypoint_dim * (1 + 2 * 3 * 2 / 3)
    assert head[0].out_features == 24
    policy.save_pretrained(tmp_path)
    kept = backbone.SpatialActPolicy.from_pretrained(tmp_path)
    policy.eval()
    batch = _batch(demos, 5)
    assert torch.equal(
        kept.model.backbone(batch)[1],
        policy.model.backbone(batch)[1],
    )


def test_a_network_without_keyframes_has_another_name(demos: Demonstrations) -> None:
    """Its transformer sees image keypoints, which that of `keyframe_act` does not."""
    policy = _policy(demos)
    assert act.SPATIAL_ACT.architecture(policy.config) is KEYFRAME_ACT
    policy.config.keyframes = 0
    assert act.SPATIAL_ACT.architecture(policy.config) is KEYPOINT_ACT


def test_the_transformer_of_keyframe_act_sees_no_image_feature(demos: Demonstrations) -> None:
    """Of a picture only the keyframes reach it: with these held, another picture changes nothing."""
    policy = _policy(demos)
    policy.eval()
    batch = _batch(demos, 0)
    other = {key: value.clone() for key, value in batch.items()}
    camera = policy.model.backbone.cameras[0]
    other[camera] = torch.rand_like(batch[camera])
    flat = torch.ones(1, policy.model.backbone.shape[0] * policy.model.backbone.shape[1])

    def held(_: torch.Tensor) -> torch.Tensor:
        return flat

    with torch.no_grad():
        assert not torch.equal(policy.model(batch).keyframes, policy.model(other).keyframes)
        assert torch.equal(policy.model(batch, held).actions, policy.model(other, held).actions)
        assert not torch.equal(policy.model(batch).actions, policy.model(other).actions)


def test_a_prediction_ends_training_once(
    demos: Demonstrations,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Only the first inference sets evaluation mode, which visits every module."""
    train(demos, TrainConfig(**SMALL), 0, tmp_path / "a")
    policy = act.SPATIAL_ACT.read(tmp_path / "a").policy
    modes_set: list[bool] = []
    batch = {
        "observation.state": torch.zeros(1, 16),
        "observation.images.cam_high": torch.zeros(1, 3, 12, 16),
    }
    policy.train()
    chunk = policy.predict_action_chunk(batch)
    assert not any(module.training for module in policy.modules())
    monkeypatch.setattr(torch.nn.Module, "train", lambda module, mode=True: modes_set.append(mode))
    policy.reset()
    assert torch.equal(policy.predict_action_chunk(batch), chunk)
    assert modes_set == []


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
        hook = lambda module, inputs, output: looks.append(output.keyframes)  # noqa: E731
        handle = policy.model.register_forward_hook(hook)
        policy.predict_action_chunk(batch)
        handle.remove()
        return looks[-1], policy.model(batch).keyframes

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


@pytest.mark.parametrize(
    ("looks", "past_n"),
    [
        ([(0.9, 0.9), (0.85, 0.9), (-1.1, -1.1), (-1.1, -1.1)], 1),
        ([(0.9, 0.9), (-0.2, -0.2), (-1.3, -1.3)], 1),  # the second look is amid the closing
        ([(0.9, 0.9), (0.1, 0.1), (-1.3, -1.3)], 1),
        ([(0.9, 0.9), (-0.2, 0.3), (-1.3, -1.3)], 1),  # one hand is a little behind
        ([(0.9, 0.9), (-0.2, -0.2), (-1.3, -1.3), (0.0, 0.0), (0.9, 0.9)], 2),
        ([(0.9, 0.9), (-1.3, 0.9), (-1.3, -1.3), (0.9, -1.3)], 3),  # one hand after the other
        ([(-1.3, 0.9), (-1.2, 0.8), (-1.3, 0.9)], 0),
    ],
)
def test_a_switch_counts_once_wherever_in_it_the_looks_fall(
    looks: list[tuple[float, float]],
    past_n: int,
) -> None:
    switches = backbone.Switches(torch.tensor([looks[0]]))
    for openings in looks[1:]:
        switches.look(torch.tensor([openings]))
    assert switches.past_n == past_n


@pytest.mark.parametrize(
    ("commanded", "looks", "past_n"),
    [
        ((0.9, 0.9), [(-1.3, -1.3), (0.0, 0.0), (0.9, 0.9)], 0),  # the start opens them
        ((0.9, 0.9), [(-1.3, -1.3), (0.9, 0.9), (-1.1, -1.1)], 1),  # and then they grasp
        ((0.9, 0.9), [(0.6, 0.6), (-1.1, -1.1)], 1),
        ((-1.3, -1.3), [(-0.7, -0.7), (0.9, 0.9)], 1),  # they begin with an object, and release
    ],
)
def test_what_the_first_command_does_to_a_gripper_is_no_switch(
    commanded: tuple[float, float],
    looks: list[tuple[float, float]],
    past_n: int,
) -> None:
    switches = backbone.Switches(torch.tensor([looks[0]]))
    switches.begin(torch.tensor([commanded]))
    for openings in looks[1:]:
        switches.look(torch.tensor([openings]))
    assert switches.past_n == past_n


def test_a_policy_driven_from_closed_grippers_keeps_its_first_keyframe(
    demos: Demonstrations,
) -> None:
    policy = _policy(demos)
    policy.eval()
    looks: list[torch.Tensor] = []
    policy.model.register_forward_hook(
        lambda _module, _inputs, output: looks.append(output.keyframes[0, 0]),
    )

    def look(openings: torch.Tensor) -> torch.Tensor:
        """Return the first command of the openings."""
        batch = _batch(demos, 0)
        batch[backbone.OBS_STATE][0, policy.config.grippers] = openings
        return policy.predict_action_chunk(batch)[0, 0, policy.config.commanded_grippers]

    commanded = look(torch.tensor([-4.0, -4.0]))
    look(commanded)

    assert (commanded > -2.0).all(), "the first command opens them"
    assert torch.allclose(looks[0], looks[1], atol=1e-5)
    assert looks[0].abs().max() > 0.0


def _policy(demos: Demonstrations, **settings: Any) -> Any:
    torch.manual_seed(0)
    policy = act.SPATIAL_ACT.make(TrainConfig(**{**SMALL, **settings}), demos)
    policy.train()
    return policy


def _batch(demos: Demonstrations, *rows: int) -> dict[str, torch.Tensor]:
    config = TrainConfig(**SMALL)
    stats = batches.dataset_statistics(demos, np.arange(len(demos)), config.std_floor)
    return batches.BatchMaker(demos, config, stats).clean(np.array(rows))


def _with_other_picture(batch: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    key = camera_key("high")
    return {**batch, key: -batch[key]}


def _differing_rows(first: torch.Tensor, second: torch.Tensor) -> list[bool]:
    return [bool(row.any()) for row in first != second]


BEFORE_BETWEEN_AFTER = (5, 30, 55)
"""Rows before, between and after two switches."""
BEGINS_BETWEEN = "minidual.policies.spatial_act.modeling_spatial_act._BEGINS_BETWEEN"


def test_in_training_the_transformer_gets_the_true_keyframes_to_come(
    demos: Demonstrations,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(BEGINS_BETWEEN, 0.0)
    policy = _policy(demos)
    batch = _batch(demos, *BEFORE_BETWEEN_AFTER)

    def rows_that_follow(*, to_come: bool) -> list[bool]:
        """Whether other keyframes, to come or past, change the actions of each row."""
        changed = (batch["keyframe_is_valid"] == to_come).unsqueeze(-1)
        other = {**batch, "keyframe": batch["keyframe"] + changed}
        return _differing_rows(policy.model(batch).actions, policy.model(other).actions)

    assert rows_that_follow(to_come=True) == [True, True, False]
    assert rows_that_follow(to_come=False) == [False] * 3
    policy.eval()
    assert rows_that_follow(to_come=True) == [False] * 3


@pytest.mark.parametrize(
    ("share", "follows"),
    [(0.0, [False] * 3), (1.0, [False, True, True])],
)
def test_past_keyframes_are_0_but_in_a_share_of_the_samples(
    demos: Demonstrations,
    monkeypatch: pytest.MonkeyPatch,
    share: float,
    follows: list[bool],
) -> None:
    """With all past keyframes, the end of a task may look like the start of its mirror image."""
    monkeypatch.setattr(BEGINS_BETWEEN, share)
    policy = _policy(demos)
    batch = _batch(demos, *BEFORE_BETWEEN_AFTER)
    actions = policy.model(batch).actions
    other = policy.model(_with_other_picture(batch)).actions
    assert _differing_rows(actions, other) == follows


def test_shares_of_a_batch_draw_in_one_thread_what_the_whole_batch_draws(
    demos: Demonstrations,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Draws in several threads come in any order: equal seeds would give other weights."""
    monkeypatch.setattr(BEGINS_BETWEEN, 0.5)
    policy = _policy(demos)
    batch = _batch(demos, *range(0, 180, 11))
    torch.manual_seed(1)
    whole = shares.Shares(policy, 1).gradient(batch).parts["l1_loss"]
    drawing_threads: list[str] = []
    rand = torch.rand

    def recorded(*size: int, **options: Any) -> torch.Tensor:
        drawing_threads.append(threading.current_thread().name)
        return rand(*size, **options)

    monkeypatch.setattr("torch.rand", recorded)
    torch.manual_seed(1)
    shared = shares.Shares(policy, 2).gradient(batch).parts["l1_loss"]
    assert drawing_threads == [threading.main_thread().name]
    assert shared == pytest.approx(whole, rel=1e-5)
    torch.manual_seed(2)
    other = shares.Shares(policy, 1).gradient(batch).parts["l1_loss"]
    assert other != pytest.approx(whole, rel=1e-4)


def _encoders_learn(policy: Any) -> list[bool]:
    """Return whether each parameter of the encoders has a gradient."""
    gradients = [parameter.grad for parameter in policy.model.backbone.encoders.parameters()]
    return [gradient is not None and bool(gradient.any()) for gradient in gradients]


def test_keyframes_alone_train_the_encoders(demos: Demonstrations) -> None:
    policy = _policy(demos)
    output = policy.model(_batch(demos, 5, 30))
    output.actions.sum().backward()
    assert not any(_encoders_learn(policy))
    assert policy.model.backbone.linear.weight.grad is None
    output.keyframes.sum().backward()
    assert all(_encoders_learn(policy))


def test_with_all_true_keyframes_the_transformer_sees_nothing_of_the_pictures(
    demos: Demonstrations,
) -> None:
    policy = _policy(demos)
    batch = _batch(demos, 5, 30)
    batch["keyframe_is_valid"][:] = True
    output = policy.model(batch)
    other = policy.model(_with_other_picture(batch))
    assert not torch.equal(output.keyframes, other.keyframes)
    assert torch.equal(output.actions, other.actions)


@pytest.mark.filterwarnings("ignore:Initializing zero-element tensors")
def test_without_keyframes_the_actions_train_the_encoders(demos: Demonstrations) -> None:
    action = demos.action.copy()
    action[:, -2:] = 1.0
    without_switches = dataclasses.replace(demos, action=action)
    policy = _policy(without_switches)
    assert policy.model.backbone.shape[0] == 0
    loss, _ = policy(_batch(without_switches, 5, 30))
    loss.backward()
    assert all(_encoders_learn(policy))
