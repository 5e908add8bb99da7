"""Random numbers of a network that answers."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def same_draws() -> Iterator[None]:
    """Let torch draw the same random numbers each time, so that a policy is a function of its look."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        yield
