"""The lesson of `pot_lift`: both hands lift the pot and set it down, moved by increments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gymnasium.vector import VectorEnv

from minidual.config.root import Config, changed
from minidual.config.seeds import stream
from minidual.environments.batched import RATE_HZ, BatchedEnv, fast_physics
from minidual.environments.observations import LIFT
from minidual.environments.scripted import record
from minidual.policies.rl.beside import Beside
from minidual.policies.rl.lesson import Demonstrated, WorldsWanted
from minidual.policies.rl.network import Description, RlNetwork
from minidual.tasks.catalogue import make_task
from minidual.trials.conditions import CONDITIONS
from minidual.trials.lessons import pilot

TASK = "pot_lift"
_ACTION = "pair_increments"
_RANDOMISED = "randomised"
"""Condition of the episodes that are drawn anew in mass, friction and sensor offset."""
_SHOWN = "rl-demonstrations"
"""Random stream of the demonstrations' starts."""


class PotLift:
    """Lift the pot together."""

    description = Description(TASK, LIFT, _ACTION, float(RATE_HZ))

    def worlds(self, config: Config, wanted: WorldsWanted) -> VectorEnv[Any, Any, Any]:
        """Return worlds, a share of them randomised; physics of 2 ms, which carries over."""
        own = fast_physics(changed(make_task(config).config, {"seed": wanted.seed}))
        randomised_n = round(wanted.randomise * wanted.worlds_n)
        parts: list[VectorEnv[Any, Any, Any]] = []
        if randomised_n < wanted.worlds_n:
            parts.append(BatchedEnv(wanted.worlds_n - randomised_n, own, purpose=wanted.purpose))
        if randomised_n:
            parts.append(
                BatchedEnv(
                    randomised_n,
                    own,
                    purpose=wanted.purpose,
                    condition=CONDITIONS[_RANDOMISED],
                ),
            )
        return Beside(parts)

    def demonstrations(self, config: Config, count: int, seed: int) -> Demonstrated:
        """Record the script, half of it randomised."""
        own = fast_physics(changed(make_task(config).config, {"seed": seed}))
        settings = config.methods.rl
        env = BatchedEnv(
            min(count, settings.worlds_n),
            own,
            purpose=_SHOWN,
            condition=CONDITIONS[_RANDOMISED] if settings.randomise > 0.0 else None,
        )
        samples = record(env, count, stream(seed, f"{_SHOWN}/noise"))
        env.close()
        return Demonstrated(samples.observations, samples.actions)

    def driver(self, config: Config, seed: int, network: RlNetwork) -> Callable[..., Any]:
        """Return the factory of trials."""
        return pilot.driver(config, seed, network)


POT_LIFT = PotLift()
