"""PPO that may begin from demonstrations.

The algorithm is that of Stable-Baselines3. Four things are added: the policy copies demonstrations
before the first update; the value learns alone for a few updates, since an untrained value would
spoil the copied policy; the value learns at a rate of its own; and each update is followed by steps
of cloning whose weight falls to zero.

A copied policy has little noise. One step of the usual rate (3e-4, deviation 0.1) moves its actions
by a third of that noise, a divergence of 0.5, where `kl_max` is 0.03: the update ends after it has
gone too far. A rate of 1.5e-5 (deviation 0.05) gives 0.005.
"""

from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from torch import nn

from minidual.config.methods import RlConfig
from minidual.policies.rl.lesson import Array32, Demonstrated
from minidual.policies.rl.network import CLIPPED, Description, Layers, Normalisation, RlNetwork
from minidual.policies.rl.vector_env import SteppedWorlds

DEVIATION_RANGE = (0.03, 1.0)
"""Bounds of the actions' standard deviation."""
_VALUE_WEIGHT = 0.05
"""Low, so that the value's gradient leaves the policy's its share of `_GRADIENT_MAX`."""
_GRADIENT_MAX = 0.5
_ADAM_EPSILON = 1e-5
_OF_VALUE = "of_value"
"""Mark of the optimiser's group with the parameters of the value."""
_CLONE_BATCH = 512
_CLONE_RATE = 1e-3
_CLONE_RATE_LAST = 1e-5
_CLONE_STEPS_OF_UPDATE = 12
"""Steps of cloning after an update of PPO."""
_DEVIATION_MIN = 1e-2
"""Least standard deviation for normalisation; some observations hardly change."""


def normalisation_of(observations: Array32) -> Normalisation:
    """Return mean and standard deviation (n,) of observations (T, n)."""
    deviation = np.maximum(observations.std(axis=0), _DEVIATION_MIN)
    return Normalisation(
        observations.mean(axis=0).astype(np.float32),
        deviation.astype(np.float32),
    )


class Normalised(nn.Module):
    """Centres and scales observations, and clips them, as `RlNetwork` does."""

    mean: torch.Tensor
    deviation: torch.Tensor

    def __init__(self, observation_space: Any, normalisation: Normalisation) -> None:
        super().__init__()
        self.features_dim = int(observation_space.shape[0])
        self.register_buffer("mean", torch.as_tensor(normalisation.mean))
        self.register_buffer("deviation", torch.as_tensor(normalisation.deviation))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return the features (N, n) of observations (N, n)."""
        centred = (observations - self.mean) / self.deviation
        return centred.clamp(-CLIPPED, CLIPPED)


class ClonedPpo(PPO):
    """PPO with a cloning term.

    Attributes:
        updates: Done.
        warming: Whether only the value learns.
    """

    demonstrations: Demonstrated | None = None
    clone_weight: float = 0.0
    clone_until: float = 0.0
    value_warmup: int = 0
    value_epochs: int = 1
    value_rate: float = 0.0
    usual_epochs: int = 1
    updates: int = 0

    @property
    def warming(self) -> bool:
        """Whether only the value learns, because the policy copies demonstrations."""
        return self.demonstrations is not None and self.updates < self.value_warmup

    def train(self) -> None:
        """Update policy and value from the collected experience, then clone."""
        for parameter in self._policy_parameters():
            parameter.requires_grad_(not self.warming)
        self.n_epochs = self.value_epochs if self.warming else self.usual_epochs
        super().train()
        if not self.warming:
            self._clone_a_little()
        with torch.no_grad():
            low, high = np.log(DEVIATION_RANGE)
            self.policy.log_std.clamp_(low, high)
        self.updates += 1

    def split_rates(self) -> None:
        """Give the value a rate of its own from here on."""
        acting = self._policy_parameters()
        known = {id(parameter) for parameter in acting}
        judging = [one for one in self.policy.parameters() if id(one) not in known]
        self.policy.optimizer = torch.optim.Adam(
            [{"params": acting}, {"params": judging, _OF_VALUE: True}],
            lr=self.value_rate,
            eps=_ADAM_EPSILON,
        )

    def _update_learning_rate(
        self,
        optimizers: list[torch.optim.Optimizer] | torch.optim.Optimizer,
    ) -> None:
        super()._update_learning_rate(optimizers)
        for group in self.policy.optimizer.param_groups:
            if group.get(_OF_VALUE):
                group["lr"] = self.value_rate

    def clone(self, steps: int) -> float:
        """Copy the demonstrations; return the loss of the last step."""
        optimiser = torch.optim.Adam(self._policy_parameters(), _CLONE_RATE)
        loss = float("nan")
        for step in range(steps):
            remaining = 1.0 - step / steps
            for group in optimiser.param_groups:
                group["lr"] = _CLONE_RATE * remaining + _CLONE_RATE_LAST
            loss = self._clone_step(optimiser, 1.0)
        return loss

    def _clone_a_little(self) -> None:
        trained = 1.0 - self._current_progress_remaining
        if self.demonstrations is None or self.clone_until <= 0.0:
            return
        weight = self.clone_weight * max(0.0, 1.0 - trained / self.clone_until)
        if weight > 0.0:
            for _ in range(_CLONE_STEPS_OF_UPDATE):
                self._clone_step(self.policy.optimizer, weight)

    def _clone_step(self, optimiser: torch.optim.Optimizer, weight: float) -> float:
        demonstrations = self.demonstrations
        if demonstrations is None:
            raise RuntimeError("there are no demonstrations to clone")
        rows = torch.randint(len(demonstrations.observations), (_CLONE_BATCH,)).numpy()
        observations = torch.as_tensor(demonstrations.observations[rows], device=self.device)
        actions = torch.as_tensor(demonstrations.actions[rows], device=self.device)
        distribution: Any = self.policy.get_distribution(observations).distribution
        loss = ((distribution.mean - actions) ** 2).mean()
        optimiser.zero_grad()
        (weight * loss).backward()
        nn.utils.clip_grad_norm_(self._policy_parameters(), _GRADIENT_MAX)
        optimiser.step()
        return float(loss.detach())

    def _policy_parameters(self) -> list[nn.Parameter]:
        policy = self.policy
        return [
            *policy.mlp_extractor.policy_net.parameters(),
            *policy.action_net.parameters(),
            policy.log_std,
        ]

    def network(self, description: Description, normalisation: Normalisation) -> RlNetwork:
        """Return the action that the method drives: the mean of the policy."""
        linear = [
            module
            for module in (*self.policy.mlp_extractor.policy_net, self.policy.action_net)
            if isinstance(module, nn.Linear)
        ]
        layers = Layers(
            tuple(module.weight.detach().cpu().numpy().copy() for module in linear),
            tuple(module.bias.detach().cpu().numpy().copy() for module in linear),
        )
        return RlNetwork(description, normalisation, layers)


def make_ppo(
    worlds: SteppedWorlds,
    config: RlConfig,
    normalisation: Normalisation,
    demonstrations: Demonstrated | None,
    seed: int,
) -> ClonedPpo:
    """Return a PPO before its first step, its policy untrained."""
    batch = min(config.batch_size, config.rollout * config.worlds_n)
    model = ClonedPpo(
        "MlpPolicy",
        worlds,
        learning_rate=lambda remaining: config.learning_rate * max(0.1, remaining),
        n_steps=config.rollout,
        batch_size=batch,
        n_epochs=config.epochs,
        gamma=config.discount,
        gae_lambda=config.gae_lambda,
        clip_range=config.clip,
        ent_coef=config.entropy,
        vf_coef=_VALUE_WEIGHT,
        max_grad_norm=_GRADIENT_MAX,
        target_kl=config.kl_max,
        policy_kwargs={
            "net_arch": {"pi": [config.hidden] * 2, "vf": [config.hidden] * 2},
            "activation_fn": nn.Tanh,
            "log_std_init": float(np.log(config.deviation)),
            "features_extractor_class": Normalised,
            "features_extractor_kwargs": {"normalisation": normalisation},
        },
        seed=seed,
        device=config.device,
        verbose=0,
    )
    model.demonstrations = demonstrations
    model.clone_weight = config.clone_weight
    model.clone_until = config.clone_until
    model.value_warmup = config.value_warmup
    model.value_epochs = config.value_epochs
    model.value_rate = config.value_rate
    model.usual_epochs = config.epochs
    model.split_rates()
    return model
