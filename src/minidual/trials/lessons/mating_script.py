"""Shows how parts that stand askew are mated: the rule of `impedance`, in the policy's own actions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv

from minidual import emergency
from minidual.environments.mating import RelativePose, mating_columns
from minidual.environments.rewards import Flags
from minidual.policies.rl.lesson import Array32, Demonstrated
from minidual.robot.pair import Array

_TRY_ACTIONS = 16
_BACK_ACTIONS = 6
"""Of a try, for drawing back and turning."""
_STUCK_M = 0.008
_FREE_M = 0.004
_SIGNS = np.array([[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
"""Signs of the part that is more askew and of the other one, in the order of the tries."""
_NOISE = 0.3
"""Standard deviation of the noise on shown actions, so that they lead back from errors too."""
_ASKED_MAX = 6
"""Episodes that are run for one that is to be shown."""
_ALONG = 1
_UNITS = np.array([0.006, 0.030, 0.006, 0.04, 0.04])


class MatingScript:
    """The rule, of N worlds: turn both parts by the angles that the gaps tell, then by other signs.

    Args:
        terms: Of the observation.
        worlds_n: N.
    """

    def __init__(self, terms: Sequence[str], worlds_n: int) -> None:
        self._columns = mating_columns(terms)
        self._tried = np.zeros(worlds_n, dtype=int)
        self._actions = np.zeros(worlds_n, dtype=int)
        self._back_m = np.zeros(worlds_n)

    def restart(self, worlds: Flags) -> None:
        """Begin episodes in the chosen worlds (N,)."""
        self._tried[worlds] = 0
        self._actions[worlds] = 0
        self._back_m[worlds] = 0.0

    def action(self, observation: Array32) -> Array:
        """Return actions (N, 5) for observations (N, k)."""
        value = self._of("value", observation) * _UNITS
        lag_m = (self._of("error", observation) * _UNITS - value)[:, _ALONG]
        guess_rad = self._of("askew_guess", observation) * _UNITS[3:]
        over = (self._actions >= _TRY_ACTIONS) & (lag_m > _STUCK_M)
        over &= self._tried < len(_SIGNS) - 1
        self._tried += over
        self._actions[over] = 0
        self._back_m = np.where(over, lag_m + _FREE_M, self._back_m)
        backs = self._actions < _BACK_ACTIONS
        goal = np.zeros_like(value)
        goal[:, _ALONG] = np.where(backs, -self._back_m, 0.0)
        goal[:, 3:] = guess_rad * self._signs(guess_rad)
        self._actions += 1
        return np.clip((goal - value) / RelativePose.step, -1.0, 1.0)

    def _of(self, term: str, observation: Array32) -> Array:
        return observation[:, self._columns[term]].astype(float)

    def _signs(self, guess_rad: Array) -> Array:
        """Return the signs (N, 2) of the present tries, of the pushed part and of the other one."""
        signs = _SIGNS[self._tried]
        own_more = np.abs(guess_rad[:, 0]) >= np.abs(guess_rad[:, 1])
        return np.where(own_more[:, None], signs, signs[:, ::-1])


def record(
    worlds: VectorEnv[Any, Any, Any],
    terms: Sequence[str],
    count: int,
    rng: np.random.Generator,
) -> Demonstrated:
    """Return observations and shown actions of successful episodes, `count` of them if there are."""
    script = MatingScript(terms, worlds.num_envs)
    observation, _ = worlds.reset()
    observed: list[list[Array32]] = [[] for _ in range(worlds.num_envs)]
    acted: list[list[Array32]] = [[] for _ in range(worlds.num_envs)]
    kept: list[tuple[list[Array32], list[Array32]]] = []
    ended_n = 0
    while len(kept) < count and ended_n < _ASKED_MAX * count:
        emergency.check()
        shown = script.action(observation)
        for number in range(worlds.num_envs):
            observed[number].append(observation[number].copy())
            acted[number].append(shown[number].astype(np.float32))
        driven = np.clip(shown + _NOISE * rng.standard_normal(shown.shape), -1.0, 1.0)
        observation, _, terminated, truncated, infos = worlds.step(driven)
        ended = terminated | truncated
        script.restart(ended)
        for number in np.flatnonzero(ended).tolist():
            ended_n += 1
            if infos["final_info"]["success"][number]:
                kept.append((observed[number], acted[number]))
            observed[number] = []
            acted[number] = []
    width = observation.shape[1]
    observations = [row for rows, _ in kept for row in rows]
    actions = [row for _, rows in kept for row in rows]
    return Demonstrated(
        np.array(observations, np.float32).reshape(-1, width),
        np.array(actions, np.float32).reshape(-1, len(RelativePose.names)),
    )
