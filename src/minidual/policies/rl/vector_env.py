"""A Gymnasium vector environment, as Stable-Baselines3 wants to see it."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.vec_env import VecEnv

from minidual.errors import DataError, UsageError


class SteppedWorlds(VecEnv):
    """N worlds that a training steps together.

    Episodes that end begin anew within the same step; `terminal_observation` of their info is the
    last observation of the old one.

    Args:
        env: Its autoreset mode is SAME_STEP.

    Raises:
        UsageError: It resets in another way, or its spaces are not of real numbers.
    """

    render_mode = None

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise UsageError(
                f"the environment's autoreset mode is {mode}; a training needs SAME_STEP",
                remedy="make_vec(..., vector_kwargs={'autoreset_mode': AutoresetMode.SAME_STEP})",
            )
        observations = env.single_observation_space
        actions = env.single_action_space
        if not isinstance(observations, spaces.Box) or not isinstance(actions, spaces.Box):
            raise UsageError("a training by reinforcement reads and gives vectors of real numbers")
        self._env = env
        super().__init__(env.num_envs, observations, actions)
        self._actions: Any = None

    def reset(self) -> Any:
        """Begin an episode in every world; return the observations (N, n)."""
        observations, _ = self._env.reset()
        return observations

    def step_async(self, actions: Any) -> None:
        """Take the actions (N, m) of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        """Step every world.

        Raises:
            DataError: An observation or a reward is not finite.
        """
        observations, rewards, terminated, truncated, infos = self._env.step(self._actions)
        if not (np.isfinite(rewards).all() and np.isfinite(observations).all()):
            raise DataError("the environment gave an observation or a reward that is not finite")
        ended = np.logical_or(terminated, truncated)
        records: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for world in np.flatnonzero(ended):
            records[world] = {
                "terminal_observation": infos["final_obs"][world],
                "TimeLimit.truncated": bool(truncated[world] and not terminated[world]),
                "success": bool(infos["final_info"]["success"][world]),
            }
        return observations, np.asarray(rewards, dtype=np.float32), ended, records

    def close(self) -> None:
        """Close the environment."""
        self._env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute, the same for all worlds."""
        value = getattr(self._env, attr_name, None)
        return [value] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the environment."""
        setattr(self._env, attr_name, value)

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: Any = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """Call a method of the environment once; return its result for each world."""
        result = getattr(self._env, method_name)(*method_args, **method_kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(
        self,
        wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]],
        indices: Any = None,
    ) -> Sequence[bool]:  # type: ignore[override]
        """Return False for each world: worlds of one process have no wrappers of their own."""
        return [False] * len(list(self._get_indices(indices)))
