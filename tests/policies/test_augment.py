"""Augmented pictures show what their draws say, and nothing else."""

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from minidual.config.learning import AugmentConfig
from minidual.policies.augment import augment, colour_maps, warps

NOTHING = {"light_log": (0.0, 0.0)} | dict.fromkeys(
    (
        "channel_gain_log",
        "channel_mixing",
        "offset",
        "permuted_share",
        "turn_deg",
        "scale",
        "shift",
    ),
    0,
)


def only(**values: object) -> AugmentConfig:
    return AugmentConfig(**{**NOTHING, "straight_share": 0.0, **values})


def pictures(n: int = 200, level: int | None = None) -> np.ndarray:
    made = np.random.default_rng(1).integers(0, 256, (n, 24, 32, 3), dtype=np.uint8)
    return made if level is None else np.full_like(made, level)


def changed(given: np.ndarray, config: AugmentConfig, seed: int = 0) -> np.ndarray:
    return augment(given, config, np.random.default_rng(seed))


@pytest.mark.parametrize("config", [only(), AugmentConfig(photometric=False, geometric=False)])
def test_without_draws_pictures_stay_as_they_are(config: AugmentConfig) -> None:
    np.testing.assert_array_equal(changed(pictures(), config), pictures())


def test_a_batch_is_repeatable_and_leaves_the_demonstrations_alone() -> None:
    given = pictures()
    before = pictures()
    first, again, other = (changed(given, AugmentConfig(), seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(given, before)
    np.testing.assert_array_equal(first, again)
    assert (first != other).any(axis=(1, 2, 3)).all()


def test_light_is_exponential_and_saturates() -> None:
    means = changed(pictures(level=100), only(light_log=(-0.6, 0.5))).mean(axis=(1, 2, 3))
    assert 100 * np.exp(-0.6) - 1 <= means.min() < 60 < 150 < means.max() <= 100 * np.exp(0.5) + 1
    assert changed(pictures(level=250), only(light_log=(0.5, 0.5))).min() == 255
    reversed_ends = changed(pictures(level=100), only(light_log=(0.5, -0.6))).mean(axis=(1, 2, 3))
    assert np.array_equal(reversed_ends, means)


def test_mixing_keeps_grey_and_gains_do_not() -> None:
    grey = pictures(level=120)
    np.testing.assert_array_equal(changed(grey, only(channel_mixing=0.3)), grey)
    channels = changed(grey, only(channel_gain_log=0.25)).mean(axis=(1, 2))
    assert np.abs(np.log(channels / 120)).max() == pytest.approx(0.25, abs=0.02)
    assert np.ptp(channels, axis=1).max() > 30


def test_mixing_and_offset_change_colours_within_their_bounds() -> None:
    red = pictures(level=0)
    red[..., 0] = 200
    mixed = changed(red, only(channel_mixing=0.3)).mean(axis=(1, 2))
    assert mixed[:, 1].max() == pytest.approx(60, abs=3)
    assert 200 * 0.4 <= mixed[:, 0].min() < 130
    lifted = changed(pictures(level=128), only(offset=0.08)).astype(int)
    assert np.abs(lifted - 128).max() == pytest.approx(20, abs=1)


def test_a_quarter_of_the_pictures_has_permuted_channels() -> None:
    given = pictures(2000)
    given[..., 0], given[..., 1], given[..., 2] = 10, 20, 30
    got = changed(given, only(permuted_share=0.25))[:, 0, 0]
    assert (np.sort(got, axis=1) == [10, 20, 30]).all()
    moved = (got != [10, 20, 30]).any(axis=1).mean()
    assert moved == pytest.approx(0.25 * 5 / 6, abs=0.03), "one of the six orders is the old one"


def test_colours_stay_in_place_and_places_keep_their_colours() -> None:
    given = pictures(50, level=50)
    given[:, 8:16, 10:20] = 200
    bright = changed(given, AugmentConfig(geometric=False, permuted_share=0.0, offset=0.0)).sum(
        axis=3,
    )
    inside = np.zeros((24, 32), dtype=bool)
    inside[8:16, 10:20] = True
    assert (np.ptp(bright[:, inside], axis=1) == 0).all()
    assert (np.ptp(bright[:, ~inside], axis=1) == 0).all()
    warped = changed(given, AugmentConfig(photometric=False))
    assert warped.min() >= 50
    assert warped.max() <= 200


def test_warps_move_a_point_as_they_say_about_the_middle() -> None:
    config = only(turn_deg=4.0, scale=0.07, shift=0.06)
    maps = warps(500, 96, 128, config, np.random.default_rng(0))
    middle = np.array([63.5, 47.5])
    shift = maps[:, :, :2] @ middle + maps[:, :, 2] - middle
    assert np.abs(shift).max(axis=0) == pytest.approx([0.06 * 128, 0.06 * 96], rel=0.02)
    scale = np.sqrt(np.linalg.det(maps[:, :, :2]))
    assert (scale.min(), scale.max()) == pytest.approx((0.93, 1.07), abs=1e-3)
    turn = np.degrees(np.arctan2(maps[:, 1, 0], maps[:, 0, 0]))
    assert (turn.min(), turn.max()) == pytest.approx((-4.0, 4.0), abs=0.05)
    dot = np.zeros((1, 96, 128, 3), dtype=np.uint8)
    cv2.circle(dot[0], (90, 30), 3, (255, 255, 255), -1)
    for seed in range(10):
        place = warps(1, 96, 128, config, np.random.default_rng(seed))[0]
        seen = augment(
            dot,
            config.model_copy(update={"photometric": False}),
            np.random.default_rng(seed),
        )[0, :, :, 0]
        y, x = np.average(np.indices(seen.shape), axis=(1, 2), weights=seen)
        np.testing.assert_allclose([x, y], place @ [90, 30, 1], atol=0.3)


def test_one_picture_in_ten_keeps_its_place() -> None:
    maps = warps(2000, 96, 128, AugmentConfig(), np.random.default_rng(0))
    straight = (maps == np.eye(2, 3)).all(axis=(1, 2)).mean()
    assert straight == pytest.approx(0.1, abs=0.02)


def test_each_kind_can_be_left_out_of_the_batch() -> None:
    maps = colour_maps(3, AugmentConfig(), np.random.default_rng(0))
    assert maps.shape == (3, 3, 4)
    given = pictures(20)
    place = changed(given, AugmentConfig(photometric=False))
    assert 0 < (place == given).all(axis=(1, 2, 3)).sum() < 20


@pytest.mark.parametrize(
    "values",
    [{"thing_size": (0.2, 0.1)}, {"light_log": (-9.0, 0.0)}, {"scale": 1.0}, {"shift": -0.1}],
)
def test_meaningless_settings_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        AugmentConfig(**values)
