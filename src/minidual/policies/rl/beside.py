"""Batches of worlds side by side, as one batch: some episodes as they are, others randomised."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space


class Beside(VectorEnv[Any, Any, Any]):
    """One batch out of several with the same spaces; `infos` hold the keys of all.

    Args:
        parts: Batches; their autoreset mode is SAME_STEP.
    """

    def __init__(self, parts: Sequence[VectorEnv[Any, Any, Any]]) -> None:
        self._parts = tuple(parts)
        first = self._parts[0]
        self.metadata = first.metadata
        self.num_envs = sum(part.num_envs for part in self._parts)
        self.single_observation_space = first.single_observation_space
        self.single_action_space = first.single_action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._ends = np.cumsum([part.num_envs for part in self._parts])

    def reset(
        self,
        *,
        seed: Any = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every world."""
        observations = [part.reset(seed=seed, options=options)[0] for part in self._parts]
        return np.concatenate(observations), {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step every world."""
        split = np.split(np.asarray(actions), self._ends[:-1])
        steps: list[Any] = [part.step(own) for part, own in zip(self._parts, split, strict=True)]
        observations, rewards, terminated, truncated = (
            np.concatenate([step[place] for step in steps]) for place in range(4)
        )
        return observations, rewards, terminated, truncated, self._joined([s[4] for s in steps])

    def close_extras(self, **kwargs: Any) -> None:
        """Close all batches."""
        for part in self._parts:
            part.close()

    def _joined(self, infos: Sequence[dict[str, Any]]) -> dict[str, Any]:
        """Return `final_obs` and the successes of `final_info`, zeros where nothing has ended."""
        shape = self.single_observation_space.shape or ()
        last: list[Any] = []
        successes: list[Any] = []
        for part, info in zip(self._parts, infos, strict=True):
            empty = {"success": np.zeros(part.num_envs, dtype=bool)}
            last.append(info.get("final_obs", np.zeros((part.num_envs, *shape), np.float32)))
            successes.append(info.get("final_info", empty)["success"])
        return {
            "final_obs": np.concatenate(last),
            "final_info": {"success": np.concatenate(successes)},
        }
