"""Random streams named by purpose, derived from the run's seed.

Only this module makes generators.
"""

import zlib

import numpy as np


def stream(seed: int, name: str, index: int = 0, *more: int) -> np.random.Generator:
    """Return the generator of draw `index` for the purpose `name`.

    Draws are independent of each other.
    """
    key = (zlib.crc32(name.encode()), index, *more)
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy=seed, spawn_key=key)))


def subseed(seed: int, name: str, index: int = 0, *more: int) -> int:
    """Return a seed in [0, 2^31), derived like `stream`."""
    return int(stream(seed, name, index, *more).integers(2**31))


def stored_stream(seed: int, *key: int) -> np.random.Generator:
    """Return the generator of a stored query set; these were drawn without names."""
    return np.random.default_rng([seed, *key])
