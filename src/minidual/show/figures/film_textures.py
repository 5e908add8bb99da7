"""Textures of films."""

import numpy as np
import numpy.typing as npt

from minidual.config.seeds import stream

_PLANKS = 6
_WOOD_RGB = (0.80, 0.66, 0.49)
_SEAM_SHARE = 0.008
"""Width of the gap between planks."""


def wood(size_px: int) -> npt.NDArray[np.uint8]:
    """Return a picture (size, size, 3) of planks, the same each time."""
    rng = stream(0, "wood")
    x = np.linspace(0.0, 1.0, size_px, endpoint=False)[None, :]
    y = np.linspace(0.0, 1.0, size_px, endpoint=False)[:, None]
    plank = np.floor(y * _PLANKS).astype(int)
    across = y * _PLANKS - plank
    tone = rng.uniform(-0.035, 0.035, _PLANKS)[plank]
    phase = rng.uniform(0.0, 10.0, _PLANKS)[plank]
    turn = 2.0 * np.pi
    bend = 0.03 * np.sin(turn * (1.3 * x + phase)) + 0.012 * np.sin(turn * (4.1 * x + 2.0 * phase))
    coarse = np.sin(turn * 3.0 * (across + 3.0 * bend + phase))
    fine = np.sin(turn * 11.0 * (across + 2.0 * bend + phase))
    noise = rng.normal(0.0, 0.008, (size_px, size_px))
    brightness = 1.0 + tone + 0.018 * coarse + 0.010 * fine + noise
    at_a_seam = (across < _SEAM_SHARE) | (across > 1.0 - _SEAM_SHARE)
    brightness = np.where(at_a_seam, 0.80 * brightness, brightness)
    colours = np.clip(np.multiply.outer(brightness, _WOOD_RGB), 0.0, 1.0)
    return (255.0 * colours).astype(np.uint8)
