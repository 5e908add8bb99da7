"""Named random streams derived from the run's seed."""

from __future__ import annotations

import zlib

import numpy as np


def stream(seed: int, name: str, index: int = 0) -> np.random.Generator:
    """Return the generator of trial `index` for the purpose `name`.

    Name and index form the spawn key: purposes are disjoint, and each trial is independent of the others.
    """
    key = (zlib.crc32(name.encode()), index)
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy=seed, spawn_key=key)))
