"""Lessons of transports: both hands pick up one object and set it down where it belongs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from gymnasium.vector import VectorEnv

from minidual.config.root import Config, changed
from minidual.config.seeds import stream
from minidual.environments.batched import RATE_HZ, BatchedEnv, fast_physics
from minidual.environments.observations import LIFT
from minidual.environments.rewards import LIFT_REWARD, LiftState, RewardTerm
from minidual.policies.rl.beside import Beside
from minidual.policies.rl.lesson import Array32, Demonstrated, WorldsWanted
from minidual.policies.rl.network import Description, RlNetwork
from minidual.tasks.catalogue import make_task
from minidual.trials.conditions import CONDITIONS
from minidual.trials.lessons import pilot
from minidual.trials.methods import MethodInputs

_RANDOMISED = "randomised"
"""Condition of the episodes that are drawn anew in mass, friction and sensor offset."""
_SHOWN = "rl-demonstrations"
"""Random stream of the demonstrations' starts."""


class Recorded(Protocol):
    """Result of a demonstrator: observations (T, n) and actions (T, m)."""

    @property
    def observations(self) -> Array32:
        """Of all successful episodes."""
        ...

    @property
    def actions(self) -> Array32:
        """That were shown, without added noise."""
        ...


type Demonstrator = Callable[[BatchedEnv, int, np.random.Generator], Recorded]
"""(environment, episodes, noise) -> successful episodes."""


class TransportLesson:
    """A transport, learned with hands that point down and move by increments.

    Args:
        task: Row of TASKS; both hands carry one object.
        observation: Terms that the policy reads.
        action: Name of its action space.
        reward: Terms of the reward.
        demonstrator: Shows how it is done, or None: from scratch.
        settings: Values of `methods.rl` that suit it; those that are set stay.
    """

    def __init__(
        self,
        task: str,
        *,
        observation: Sequence[str] = LIFT,
        action: str = "pair_increments",
        reward: Sequence[RewardTerm[LiftState]] = LIFT_REWARD,
        demonstrator: Demonstrator | None = None,
        settings: Mapping[str, Any] = MappingProxyType({}),
    ) -> None:
        self.settings = dict(settings)
        self._description = Description(task, tuple(observation), action, float(RATE_HZ))
        self._reward = tuple(reward)
        self._demonstrator = demonstrator

    def describe(self, config: Config) -> Description:
        """Return the inputs and outputs of the policy."""
        return self._description

    def worlds(self, config: Config, wanted: WorldsWanted) -> VectorEnv[Any, Any, Any]:
        """Return worlds, a share of them randomised; their physics of 2 ms carries over to trials."""
        own = _own_config(config, wanted.seed)
        randomised_n = round(wanted.randomise * wanted.worlds_n)
        parts: list[VectorEnv[Any, Any, Any]] = []
        if randomised_n < wanted.worlds_n:
            parts.append(self._batch(wanted.worlds_n - randomised_n, own, wanted.purpose))
        if randomised_n:
            parts.append(self._batch(randomised_n, own, wanted.purpose, randomised=True))
        return Beside(parts)

    def demonstrations(self, config: Config, count: int, seed: int) -> Demonstrated | None:
        """Record the demonstrator, randomised if the training is."""
        if self._demonstrator is None:
            return None
        settings = config.methods.rl
        env = self._batch(
            min(count, settings.worlds_n),
            _own_config(config, seed),
            _SHOWN,
            randomised=settings.randomise > 0.0,
        )
        recorded = self._demonstrator(env, count, stream(seed, f"{_SHOWN}/noise"))
        env.close()
        return Demonstrated(recorded.observations, recorded.actions)

    def driver(self, inputs: MethodInputs, network: RlNetwork) -> Callable[..., Any]:
        """Return the factory of trials."""
        return pilot.driver(inputs, network)

    def _batch(
        self,
        worlds_n: int,
        config: Config,
        purpose: str,
        *,
        randomised: bool = False,
    ) -> BatchedEnv:
        return BatchedEnv(
            worlds_n,
            config,
            purpose=purpose,
            condition=CONDITIONS[_RANDOMISED] if randomised else None,
            action=self._description.action,
            observation=self._description.observation,
            reward=self._reward,
        )


def _own_config(config: Config, seed: int) -> Config:
    """Return the task's configuration with the training's seed and the faster physics."""
    return fast_physics(changed(make_task(config).config, {"seed": seed}))
