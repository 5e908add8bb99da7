"""Change training pictures as other rooms and other camera poses would.

Colours: c' = e^l diag(e^g) M P c + o with light l, channel gains g, mixing M (grey stays grey),
permutation P. Places: turn, scale and shift about the middle; the border is repeated.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from minidual.config.learning import AugmentConfig

FULL = 255.0
_UNMOVED = np.eye(2, 3)


def colour_maps(n: int, config: AugmentConfig, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw maps (n, 3, 4) of colours in 0..255."""
    light = rng.uniform(min(config.light_log), max(config.light_log), n)
    gains = rng.uniform(-1.0, 1.0, (n, 3)) * config.channel_gain_log
    mixing = rng.uniform(-1.0, 1.0, (n, 3, 3)) * config.channel_mixing
    offset = FULL * config.offset * rng.uniform(-1.0, 1.0, (n, 3))
    order = np.argsort(rng.random((n, 3)), axis=1)
    order[rng.random(n) >= config.permuted_share] = np.arange(3)
    # Rows of a mixing sum to 1, so that grey stays grey.
    diagonal = np.arange(3)
    mixing[:, diagonal, diagonal] = 0.0
    mixing[:, diagonal, diagonal] = 1.0 - mixing.sum(axis=2)
    order_of_each_row = np.repeat(order[:, None, :], 3, axis=1)
    mixed = np.take_along_axis(mixing, order_of_each_row, axis=2)
    brightness = np.exp(light[:, None] + gains)
    linear = brightness[:, :, None] * mixed
    return np.concatenate([linear, offset[:, :, None]], axis=2).astype(np.float32)


def warps(
    n: int,
    height: int,
    width: int,
    config: AugmentConfig,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Draw maps (n, 2, 3) of places [pixels]."""
    turn = np.radians(config.turn_deg) * rng.uniform(-1.0, 1.0, n)
    scale = 1.0 + config.scale * rng.uniform(-1.0, 1.0, n)
    shift = config.shift * rng.uniform(-1.0, 1.0, (n, 2)) * (width, height)
    straight = rng.random(n) < config.straight_share
    turn[straight] = 0.0
    scale[straight] = 1.0
    shift[straight] = 0.0
    along = scale * np.cos(turn)
    across = scale * np.sin(turn)
    linear = np.stack([along, -across, across, along], axis=1).reshape(n, 2, 2)
    middle = np.array([0.5 * (width - 1), 0.5 * (height - 1)])
    return np.dstack([linear, middle + shift - linear @ middle])


def augment(
    pictures: NDArray[np.uint8],
    config: AugmentConfig,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Return changed copies of pictures (n, H, W, 3)."""
    n, height, width, _ = pictures.shape
    changed = pictures.copy()
    # All colours are drawn before all places: the order of the draws is part of the result.
    colours = colour_maps(n, config, rng) if config.photometric else None
    places = warps(n, height, width, config, rng) if config.geometric else None
    for k, picture in enumerate(changed):
        if colours is not None:
            cv2.transform(picture, colours[k], dst=picture)
        if places is not None and (places[k] != _UNMOVED).any():
            picture[:] = cv2.warpAffine(
                picture,
                places[k],
                (width, height),
                borderMode=cv2.BORDER_REPLICATE,
            )
    return changed
