"""The lesson of `insertion`: the planner brings peg and socket before each other, a policy mates them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from gymnasium.vector import VectorEnv

from minidual.config.root import Config, changed
from minidual.config.seeds import stream
from minidual.environments.mating import ACTION, mating_terms
from minidual.policies.rl.lesson import Demonstrated, WorldsWanted
from minidual.policies.rl.network import Description, RlNetwork
from minidual.tasks.catalogue import make_task
from minidual.trials.branching import Forge, Trunks
from minidual.trials.conditions import CLEAN
from minidual.trials.lessons import mating_pilot
from minidual.trials.lessons.mating_episode import MatingRuns
from minidual.trials.lessons.mating_script import record
from minidual.trials.lessons.mating_worlds import MatingWorlds
from minidual.trials.methods import MethodInputs

_RANDOMISED = "randomised"
_SHOWN = "rl-demonstrations"
"""Random stream of the demonstrations' starts."""


class InsertionLesson:
    """A mating in the air, learned on trials that branch where the parts are before each other.

    Attributes:
        title: What drives.
        settings: Values of `methods.rl` that suit it; those that are set stay.
    """

    title = "planner + learned insertion"
    settings: Mapping[str, Any] = {
        "worlds_n": 16,
        "rollout": 64,
        "batch_size": 256,
        "steps": 60_000,
        "demonstrations_n": 40,
        "clone_steps": 1500,
        "value_warmup": 2,
        "deviation": 0.2,
        "learning_rate": 6e-5,
        "validation_starts": 24,
        "validate_every_updates": 10,
    }

    def __init__(self) -> None:
        self._trunks: dict[str, Trunks] = {}

    def describe(self, config: Config) -> Description:
        """Return the inputs and outputs of the policy."""
        terms = mating_terms(senses_force=config.methods.rl.senses_force)
        return Description("insertion", terms, ACTION, mating_pilot.RATE_HZ)

    def worlds(self, config: Config, wanted: WorldsWanted) -> VectorEnv[Any, Any, Any]:
        """Return worlds, a share of them randomised, all from one process that starts trials."""
        own = changed(make_task(config).config, {"seed": wanted.seed})
        randomised_n = round(wanted.randomise * wanted.worlds_n)
        conditions = [CLEAN] * (wanted.worlds_n - randomised_n) + [_RANDOMISED] * randomised_n

        return MatingWorlds(
            self._trunks_of(own),
            conditions,
            wanted.purpose,
            self.describe(own).observation,
            episodes=own.methods.rl.episodes_of_start,
            workers=own.workers,
            once=wanted.once,
        )

    def demonstrations(self, config: Config, count: int, seed: int) -> Demonstrated | None:
        """Record the rule by which `impedance` corrects parts that stand askew."""
        settings = config.methods.rl
        worlds_n = min(count, settings.worlds_n)
        wanted = WorldsWanted(worlds_n, seed, _SHOWN, settings.randomise)
        worlds = self.worlds(config, wanted)
        noise = stream(seed, f"{_SHOWN}/noise")
        try:
            shown = record(worlds, self.describe(config).observation, count, noise)
        finally:
            worlds.close()
        return shown if len(shown.actions) else None

    def driver(self, inputs: MethodInputs, network: RlNetwork) -> Callable[..., Any]:
        """Return the factory of trials."""
        return mating_pilot.driver(inputs, network)

    def _trunks_of(self, config: Config) -> Trunks:
        """Return the trials of a configuration; the process that starts them lives as long as this one."""
        key = config.model_dump_json()
        if key not in self._trunks:
            terms = self.describe(config).observation
            self._trunks[key] = Trunks(Forge(MatingRuns, config, config.seed, terms))
        return self._trunks[key]


INSERTION = InsertionLesson()
