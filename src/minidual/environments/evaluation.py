"""Run each of a number of trials once, in a batched environment."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from minidual.environments.batched import BatchedEnv

type Act = Callable[[npt.NDArray[np.float32]], npt.ArrayLike]
"""Takes observations (N, k), returns actions (N, j)."""


def evaluate(
    env: BatchedEnv,
    act: Act,
    trials_n: int,
    purpose: str,
    restart: Callable[[npt.NDArray[np.bool_]], None] | None = None,
) -> list[dict[str, Any]]:
    """Return the outcomes of trials 0 to n - 1 of a stream, see `final_info` of the environment.

    Args:
        restart: Called with the worlds (N,) in which a trial ended, for what remembers a trial.
    """
    observation, _ = env.reset(options={"purpose": purpose, "first": 0})
    outcomes: dict[int, dict[str, Any]] = {}
    while len(outcomes) < trials_n:
        observation, _, terminated, truncated, info = env.step(act(observation))
        ended = terminated | truncated
        for world in np.flatnonzero(ended).tolist():
            outcome = {name: values[world] for name, values in info["final_info"].items()}
            index = int(outcome["trial"])
            if index < trials_n:
                outcomes[index] = outcome
        if restart is not None:
            restart(ended)
    return [outcomes[index] for index in range(trials_n)]
