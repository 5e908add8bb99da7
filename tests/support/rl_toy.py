"""A lesson that a few hundred actions teach: points that must reach their marks on a line."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv

from minidual.config.seeds import stream
from minidual.policies.rl.lesson import Demonstrated
from minidual.policies.rl.network import Description

STEPS_MAX = 12
STEP_M = 0.2
NEAR_M = 0.1


class Points(VectorEnv[Any, Any, Any]):
    """N points on a line; an action moves each by up to `STEP_M`."""

    metadata: ClassVar[dict[str, Any]] = {"autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(self, wanted: Any) -> None:
        self.num_envs = wanted.worlds_n
        self.single_observation_space = spaces.Box(-5.0, 5.0, (2,))
        self.single_action_space = spaces.Box(-1.0, 1.0, (1,))
        self.observation_space = gymnasium.vector.utils.batch_space(
            self.single_observation_space,
            self.num_envs,
        )
        self.action_space = gymnasium.vector.utils.batch_space(
            self.single_action_space,
            self.num_envs,
        )
        self.rng = stream(wanted.seed, wanted.purpose)
        self.place = np.zeros(self.num_envs)
        self.mark = np.zeros(self.num_envs)
        self.taken = np.zeros(self.num_envs, dtype=int)

    def _begin(self, worlds: Any) -> None:
        count = len(worlds)
        self.place[worlds] = self.rng.uniform(-1.0, 1.0, count)
        self.mark[worlds] = self.rng.uniform(-1.0, 1.0, count)
        self.taken[worlds] = 0

    def _observations(self) -> Any:
        return np.stack([self.mark - self.place, self.place], axis=-1).astype(np.float32)

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        self._begin(np.arange(self.num_envs))
        return self._observations(), {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        before = np.abs(self.mark - self.place)
        self.place += STEP_M * np.clip(actions[:, 0], -1.0, 1.0)
        self.taken += 1
        distance = np.abs(self.mark - self.place)
        success = distance < NEAR_M
        truncated = ~success & (self.taken >= STEPS_MAX)
        rewards = before - distance + success
        last = self._observations()
        ended = np.flatnonzero(success | truncated)
        self._begin(ended)
        infos = {"final_obs": last, "final_info": {"success": success}}
        return self._observations(), rewards, success, truncated, infos


class ToyLesson:
    """Points that reach their marks."""

    def __init__(self, shown: bool = True) -> None:
        self.shown = shown

    def describe(self, config: Any) -> Any:
        return Description("rod_carry", ("to_mark", "place"), "along", 10.0)

    def worlds(self, config: Any, wanted: Any) -> Points:
        return Points(wanted)

    def demonstrations(self, config: Any, count: int, seed: int) -> Any:
        if not self.shown:
            return None
        rng = stream(seed, "shown")
        to_mark = rng.uniform(-2.0, 2.0, 20 * count)
        place = rng.uniform(-1.0, 1.0, 20 * count)
        observations = np.stack([to_mark, place], axis=-1).astype(np.float32)
        actions = np.clip(to_mark / STEP_M, -1.0, 1.0)[:, None].astype(np.float32)
        return Demonstrated(observations, actions)
