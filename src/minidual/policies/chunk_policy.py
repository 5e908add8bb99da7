"""A loaded policy, as the runtime sees it."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from minidual.policies.facts import PolicyFacts

Image = NDArray[np.uint8]


class ChunkPolicy(ABC):
    """A loaded checkpoint.

    Attributes:
        cameras: Image size (H, W) by camera.
        chunk_size: Actions per inference.
        dim: Entries of an action: of two arms the number of joints, plus two grippers.
        own_pace: It looks at every tick and keeps its own queue of actions; `chunk_size` is 1.
        answer_s: Wall time of its last answer that counts as simulated time: 0 for a policy of this
            process, for which the simulation waits.
        facts: What is known of its training.
        inputs: {recorded signal: entries} that a state holds behind joints and openings.
    """

    cameras: Mapping[str, tuple[int, int]]
    chunk_size: int
    dim: int
    own_pace: bool = False
    answer_s: float = 0.0
    facts: PolicyFacts = PolicyFacts()
    inputs: Mapping[str, int] = MappingProxyType({})

    @property
    def state_dim(self) -> int:
        """Entries of a state, inputs included."""
        return self.dim + self.inputs_n

    @property
    def inputs_n(self) -> int:
        """Entries of all inputs."""
        return sum(self.inputs.values())

    def reset(self) -> None:  # noqa: B027
        """Forget earlier observations: a new episode begins."""

    def instruct(self, task: str) -> None:  # noqa: B027
        """Take the task's instruction, for policies that read one."""

    @abstractmethod
    def predict(
        self,
        images: Mapping[str, Image],
        state: NDArray[np.float32],
    ) -> NDArray[np.float64]:
        """Return actions (chunk_size, dim): joint targets [rad], then openings.

        `images`: (H, W, 3). `state`: (state_dim,), as measured: joints, openings, inputs.
        """
