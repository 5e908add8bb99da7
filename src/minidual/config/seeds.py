"""One seed a run, many named streams: no two purposes ever share random numbers."""

from __future__ import annotations

import zlib

import numpy as np


def stream(seed: int, name: str, index: int = 0) -> np.random.Generator:
    """Return the generator of trial `index` of the purpose `name`.

    The purpose is part of the spawn key, so tuning, demonstrations, validation and test are disjoint by
    construction, and trial 17 is the same whether sixteen came before it or none.
    """
    key = (zlib.crc32(name.encode()), index)
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy=seed, spawn_key=key)))
