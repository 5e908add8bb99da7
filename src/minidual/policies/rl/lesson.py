"""What can be learned by reinforcement: worlds to try in, and perhaps demonstrations to begin from.

Other distributions add lessons for tasks of their own through the entry point group
`minidual.lessons` (docs/howto-rl.md).
"""

from typing import Any, NamedTuple, Protocol

from gymnasium.vector import VectorEnv

from minidual.config.root import Config
from minidual.policies.rl.cloned_ppo import Demonstrated
from minidual.policies.rl.network import Description
from minidual.registry import Registry


class WorldsWanted(NamedTuple):
    """Which worlds a training asks for.

    Attributes:
        worlds_n: Simulations side by side.
        seed: Of the training.
        purpose: Random stream of the starts.
        randomise: Share of episodes with drawn masses, frictions and sensor offsets.
    """

    worlds_n: int
    seed: int
    purpose: str
    randomise: float


class Lesson(Protocol):
    """One task that is learned by trying."""

    @property
    def description(self) -> Description:
        """What the policy reads and gives."""
        ...

    def worlds(self, config: Config, wanted: WorldsWanted) -> VectorEnv[Any, Any, Any]:
        """Return a batch of worlds whose autoreset mode is SAME_STEP.

        `infos["final_info"]["success"]` (N,) tells of each ended episode whether it succeeded.
        """
        ...

    def demonstrations(self, config: Config, count: int, seed: int) -> Demonstrated | None:
        """Return successful demonstrations, or None if there is nobody who shows them."""
        ...


LESSONS: Registry[Lesson] = Registry("lesson", group="minidual.lessons")
"""Lessons by task."""
