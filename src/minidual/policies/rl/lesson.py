"""A task to learn by reinforcement: worlds to try in, and optional demonstrations to begin from.

Other distributions add lessons for tasks of their own through the entry point group
`minidual.lessons` (docs/howto-rl.md). This module imports no learning library: the table of methods
asks it which tasks can be learned.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from minidual.registry import Registry

if TYPE_CHECKING:
    from collections.abc import Callable

    from gymnasium.vector import VectorEnv

    from minidual.config.root import Config
    from minidual.policies.rl.network import Description, RlNetwork

type Array32 = npt.NDArray[np.float32]


class WorldsWanted(NamedTuple):
    """Which worlds a training asks for.

    Attributes:
        worlds_n: Simulations side by side.
        seed: Of the training.
        purpose: Random stream of the starts.
        randomise: Share of episodes with drawn masses, frictions and sensor offsets.
        once: Whether only the first episode of each world counts: a world may rest after it.
    """

    worlds_n: int
    seed: int
    purpose: str
    randomise: float
    once: bool = False


class Demonstrated(NamedTuple):
    """Observations (T, n) and actions (T, m) of successful demonstrations."""

    observations: Array32
    actions: Array32


class Lesson(Protocol):
    """One task that is learned by trying.

    A lesson may have two attributes more: `title`, what drives where the policy does only a part,
    and `settings`, {setting of `methods.rl`: value} for those that are left at their defaults.
    """

    def describe(self, config: Config) -> Description:
        """Return the inputs and outputs of the policy."""
        ...

    def worlds(self, config: Config, wanted: WorldsWanted) -> VectorEnv[Any, Any, Any]:
        """Return a batch of worlds whose autoreset mode is SAME_STEP.

        `infos["final_info"]["success"]` (N,) tells of each ended episode whether it succeeded.
        """
        ...

    def demonstrations(self, config: Config, count: int, seed: int) -> Demonstrated | None:
        """Return successful demonstrations, or None if the lesson has no demonstrator."""
        ...

    def driver(self, inputs: Any, network: RlNetwork) -> Callable[..., Any]:
        """Return the factory of trials that the network drives, as `MethodSpec.build` does.

        Args:
            inputs: `trials.methods.MethodInputs`.
            network: The policy.
        """
        ...


LESSONS: Registry[Lesson] = Registry(
    "lesson",
    {  # by name: they import simulations
        "pot_lift": "minidual.trials.lessons.pot_lift:POT_LIFT",
        "insertion": "minidual.trials.lessons.insertion:INSERTION",
    },
    group="minidual.lessons",
)
"""Lessons by task."""


def title_of(task: str) -> str:
    """Return what drives a task with a policy learned by trying, or "" where the policy does it all."""
    if task not in LESSONS:
        return ""
    return str(getattr(LESSONS[task], "title", ""))
