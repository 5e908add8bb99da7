"""The update of a policy's weights in training."""

import copy
import math
from typing import Any

import torch
from torch.optim.swa_utils import get_ema_multi_avg_fn

from minidual.config.learning import TrainConfig

LAST_RATE_SHARE = 0.01
"""Learning rate of the last step, of the largest."""


def learning_rate(config: TrainConfig, step: int) -> float:
    """Return the rate of a step: linear warm-up, then cosine decay to one hundredth."""
    warmup_steps = max(1, round(config.warmup_fraction * config.steps))
    if step < warmup_steps:
        return config.learning_rate * (step + 1) / warmup_steps
    progress = (step - warmup_steps) / max(1, config.steps - warmup_steps)
    cosine = 0.5 * (1.0 + math.cos(math.pi * progress))
    return config.learning_rate * (LAST_RATE_SHARE + (1.0 - LAST_RATE_SHARE) * cosine)


class Optimiser:
    """AdamW with clipped gradients, scheduled rates and a moving average of the weights.

    Attributes:
        averaged: The policy with averaged weights; `policy` itself without an average.
        parameters_n: Trained numbers.
    """

    def __init__(self, policy: Any, config: TrainConfig) -> None:
        self._config = config
        self._parameters = _trained_parameters(policy)
        self.parameters_n = sum(parameter.numel() for parameter in self._parameters)
        self._adam = torch.optim.AdamW(
            policy.get_optim_params(),
            lr=config.learning_rate,
            weight_decay=config.weight_decay,
            fused=True,
        )
        # Groups of parameters may have a rate of their own; it follows the course of the common one.
        self._rate_ratios = [
            group["lr"] / config.learning_rate for group in self._adam.param_groups
        ]
        self.averaged = copy.deepcopy(policy) if config.ema_decay > 0 else policy
        self._averages = _trained_parameters(self.averaged)

    def set_rate(self, step: int) -> float:
        """Set and return the learning rate of a step."""
        rate = learning_rate(self._config, step)
        for group, ratio in zip(self._adam.param_groups, self._rate_ratios, strict=True):
            group["lr"] = ratio * rate
        return rate

    def clip(self) -> None:
        """Limit the norm of the gradient."""
        torch.nn.utils.clip_grad_norm_(self._parameters, self._config.gradient_clip)

    def update(self, step: int) -> None:
        """Update the weights by their gradients, then the average."""
        self._adam.step()
        if self._config.ema_decay > 0:
            # Short memory at first, so that the random initial weights leave the average.
            decay = min(self._config.ema_decay, (1 + step) / (10 + step))
            get_ema_multi_avg_fn(decay)(self._averages, self._parameters, 0)

    def state_dict(self) -> dict[str, Any]:
        """Return the state of AdamW."""
        return self._adam.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Set the state of AdamW."""
        self._adam.load_state_dict(state)


def _trained_parameters(policy: Any) -> list[torch.Tensor]:
    return [parameter for parameter in policy.parameters() if parameter.requires_grad]
