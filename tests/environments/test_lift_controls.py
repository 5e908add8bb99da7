"""Nothing that cannot lift the pot passes: one arm alone, random actions, no actions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.environments.batched import BatchedEnv
from minidual.environments.evaluation import Act, evaluate
from minidual.environments.scripted import LiftScript

CONFIG = Config(task="pot_lift")
TRIALS_N = 256
WORLDS_N = 64
PURPOSE = "lift-controls"

pytestmark = pytest.mark.slow


def successes_n(act_of: Callable[[BatchedEnv], Act], trials_n: int, **settings: Any) -> int:
    """Return how many trials succeed; the supervisor ends none early."""
    env = BatchedEnv(WORLDS_N, CONFIG, fast=True, purpose=PURPOSE, supervised=False, **settings)
    act = act_of(env)
    restart = getattr(act, "restart", None)
    outcomes = evaluate(env, act, trials_n, PURPOSE, restart)
    env.close()
    return sum(bool(outcome["success"]) for outcome in outcomes)


class Scripted:
    """The script of the demonstrations as a policy."""

    def __init__(self, env: BatchedEnv) -> None:
        self._script = LiftScript(env)
        self.restart = self._script.restart

    def __call__(self, observation: Any) -> Any:
        return self._script.action()


def at_random(env: BatchedEnv) -> Act:
    rng = np.random.default_rng(7)
    return lambda observation: rng.uniform(-1.0, 1.0, env.action_space.shape)


def nothing(env: BatchedEnv) -> Act:
    return lambda observation: np.zeros(env.action_space.shape)


def test_both_arms_of_the_script_succeed() -> None:
    assert successes_n(Scripted, WORLDS_N) >= 0.9 * WORLDS_N


@pytest.mark.parametrize("frozen", ["left", "right"])
def test_one_arm_of_the_script_never_succeeds(frozen: str) -> None:
    assert successes_n(Scripted, TRIALS_N, frozen=frozen) == 0


@pytest.mark.parametrize("act_of", [at_random, nothing])
def test_random_and_zero_actions_never_succeed(act_of: Callable[[BatchedEnv], Act]) -> None:
    assert successes_n(act_of, TRIALS_N) == 0
