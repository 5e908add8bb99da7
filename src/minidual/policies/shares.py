"""Gradients of a batch, one share of it on each thread.

Torch's own threads wait for each other in every layer, those with shares of their own once a step.
"""

import copy
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor

Losses = Mapping[str, float]


class Shares:
    """Copies of a policy with common weights and gradients of their own.

    `forward(batch)` of a policy returns (loss, parts); it must not draw random numbers if `count` is above 1.
    """

    def __init__(self, policy: Any, count: int) -> None:
        self.policies = [policy, *(_sharing(policy) for _ in range(count - 1))]
        self._parameters = [[p for p in own.parameters() if p.requires_grad] for own in self.policies]
        self._pool = ThreadPoolExecutor(count, initializer=torch.set_num_threads, initargs=(1,))

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()

    def gradient(self, batch: dict[str, Tensor]) -> tuple[float, Losses]:
        """Leave the batch's mean gradient in the first policy; return loss and parts."""
        if len(self.policies) == 1:
            return _gradient(self.policies[0], batch)
        rows = len(next(iter(batch.values())))
        shares = [slice(*ends) for ends in pairwise(np.linspace(0, rows, len(self.policies) + 1).astype(int).tolist())]
        weights = [(share.stop - share.start) / rows for share in shares]
        if not all(weights):
            raise ValueError(f"{rows} rows cannot be shared by {len(shares)} threads")
        split = [{key: values[share] for key, values in batch.items()} for share in shares]
        results = list(self._pool.map(_gradient, self.policies, split))
        for same in zip(*self._parameters, strict=True):
            if same[0].grad is not None:
                same[0].grad = sum(w * p.grad for w, p in zip(weights, same, strict=True))
        mean = lambda values: sum(w * v for w, v in zip(weights, values, strict=True))  # noqa: E731
        parts = {name: mean([parts[name] for _, parts in results]) for name in results[0][1]}
        return mean([loss for loss, _ in results]), parts


def _sharing(policy: Any) -> Any:
    other = copy.deepcopy(policy)
    for own, common in zip(other.parameters(), policy.parameters(), strict=True):
        own.data = common.data
    return other


def _gradient(policy: Any, batch: dict[str, Tensor]) -> tuple[float, Losses]:
    policy.zero_grad(set_to_none=True)
    loss, parts = policy.forward(batch)
    loss.backward()
    return float(loss.detach()), parts
