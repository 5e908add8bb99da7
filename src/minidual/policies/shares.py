"""Gradients of a batch, computed by several threads."""

import copy
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

Losses = Mapping[str, float]


class BatchLoss(NamedTuple):
    """The loss of a batch and its parts by name."""

    loss: float
    parts: Losses


class Shares:
    """Copies of a policy with common weights and gradients of their own.

    Each thread computes one share of a batch. Torch's own threads wait for each other in every
    layer, these once a step. `forward(batch)` of a policy returns (loss, parts). If `count` is above
    1 it must not draw random numbers, because threads would draw in any order: `with_draws(batch)`,
    if a policy has it, adds to a batch what is to be drawn.
    """

    def __init__(self, policy: Any, count: int) -> None:
        copies = [_with_common_weights(policy) for _ in range(count - 1)]
        self.policies = [policy, *copies]
        self._parameters = [
            [parameter for parameter in each.parameters() if parameter.requires_grad]
            for each in self.policies
        ]
        self._pool = ThreadPoolExecutor(count, initializer=torch.set_num_threads, initargs=(1,))

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()

    def gradient(self, batch: dict[str, Tensor]) -> BatchLoss:
        """Leave the batch's mean gradient in the first policy; return the mean loss."""
        if len(self.policies) == 1:
            return _gradient(self.policies[0], batch)
        rows_n = len(next(iter(batch.values())))
        shares = _split(rows_n, len(self.policies))
        weights = [(share.stop - share.start) / rows_n for share in shares]
        with_draws = getattr(self.policies[0], "with_draws", None)
        if with_draws is not None:
            batch = with_draws(batch)
        batches = [{key: values[share] for key, values in batch.items()} for share in shares]
        results = list(self._pool.map(_gradient, self.policies, batches))
        self._add_gradients(weights)
        names = results[0].parts
        return BatchLoss(
            loss=_weighted_sum(weights, [result.loss for result in results]),
            parts={
                name: _weighted_sum(weights, [result.parts[name] for result in results])
                for name in names
            },
        )

    def _add_gradients(self, weights: Sequence[float]) -> None:
        """Replace the first policy's gradients by the weighted sum over all."""
        for copies_of_one in zip(*self._parameters, strict=True):
            first = copies_of_one[0]
            if first.grad is not None:
                first.grad = sum(
                    weight * parameter.grad
                    for weight, parameter in zip(weights, copies_of_one, strict=True)
                )


def _split(rows_n: int, count: int) -> list[slice]:
    """Return `count` slices of nearly equal length; ValueError if one is empty."""
    ends = np.linspace(0, rows_n, count + 1).astype(int).tolist()
    shares = [slice(start, stop) for start, stop in pairwise(ends)]
    if any(share.start == share.stop for share in shares):
        raise ValueError(f"{rows_n} rows cannot be shared by {count} threads")
    return shares


def _weighted_sum(weights: Sequence[float], values: Sequence[float]) -> float:
    return sum(weight * value for weight, value in zip(weights, values, strict=True))


def _with_common_weights(policy: Any) -> Any:
    """Return a copy of a policy that shares its weights, not its gradients."""
    other = copy.deepcopy(policy)
    for own, common in zip(other.parameters(), policy.parameters(), strict=True):
        own.data = common.data
    return other


def _gradient(policy: Any, batch: dict[str, Tensor]) -> BatchLoss:
    policy.zero_grad(set_to_none=True)
    loss, parts = policy.forward(batch)
    loss.backward()
    return BatchLoss(float(loss.detach()), parts)
