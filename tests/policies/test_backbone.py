"""The spatial softmax finds pixels, to a fraction of one, and keeps finding them in bfloat16."""

from __future__ import annotations

import pytest

from tests.support.late import late

torch = late("torch")
backbone = late("minidual.policies.spatial_act.modeling_spatial_act")
pytestmark = pytest.mark.torch


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
