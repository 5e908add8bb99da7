"""A policy for several tasks: it reads which instruction holds."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from minidual.errors import UsageError
from minidual.policies.chunk_policy import ChunkPolicy, Image


class InstructedPolicy(ChunkPolicy):
    """A policy that is told which of its tasks to do.

    Args:
        policy: Its network. Behind what is sensed, a state of it holds an entry for each
            instruction: 1 for the one that holds, 0 for the others.
        instructions: In the order of these entries.
    """

    def __init__(self, policy: ChunkPolicy, instructions: Sequence[str]) -> None:
        self._policy = policy
        self._instructions = tuple(instructions)
        self._told: NDArray[np.float32] | None = None
        self.cameras = policy.cameras
        self.chunk_size = policy.chunk_size
        self.dim = policy.dim
        self.own_pace = policy.own_pace
        self.facts = policy.facts

    @property
    def state_dim(self) -> int:
        """Entries of a state, inputs included, without the instructions."""
        return self._policy.state_dim - len(self._instructions)

    def reset(self) -> None:
        """See `ChunkPolicy.reset`; the instruction stays."""
        self._policy.reset()

    def instruct(self, task: str) -> None:
        """Take the instruction.

        Raises:
            UsageError: The policy was not trained on it.
        """
        if task not in self._instructions:
            raise UsageError(
                f"the policy cannot do '{task}'; {self._choice()}",
                remedy="train one on both: minidual data merge, then train-act --dataset",
            )
        self._told = np.array([task == own for own in self._instructions], dtype=np.float32)

    def predict(
        self,
        images: Mapping[str, Image],
        state: NDArray[np.float32],
    ) -> NDArray[np.float64]:
        """See `ChunkPolicy.predict`.

        Raises:
            UsageError: It was not told what to do.
        """
        if self._told is None:
            raise UsageError(f"the policy was not told what to do; {self._choice()}")
        return self._policy.predict(images, np.concatenate([state, self._told]))

    def _choice(self) -> str:
        quoted = [f"'{instruction}'" for instruction in self._instructions]
        return f"it was trained to: {', '.join(quoted)}"
