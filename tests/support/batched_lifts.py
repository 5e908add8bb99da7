"""Lifts that a single environment and a batched one play with the same joint targets."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from minidual.config.root import Config
from minidual.config.seeds import stream
from minidual.environments.batched import BatchedEnv
from minidual.environments.scripted import LiftScript
from minidual.environments.task_env import TaskEnv

PURPOSE = "equality"
EARLY_STEP = 100
"""Control steps after which joints are compared: hands have grasped, contacts have not amplified rounding."""


class Played(NamedTuple):
    """How one episode went: steps, success, names of what was violated, and the joints after 2 s."""

    steps_n: int
    success: bool
    failures: tuple[str, ...]
    q: np.ndarray


class TargetRecorder:
    """Records the joint targets of a scripted lift, with noise of one size for each episode."""

    def __init__(self) -> None:
        self._env = BatchedEnv(
            1, Config(task="pot_lift"), purpose=PURPOSE, supervised=False, end_at_violation=False
        )
        self._script = LiftScript(self._env)

    def targets(self, episode: int) -> np.ndarray:
        """Return joint targets and openings (T, n + 2) at 50 Hz."""
        env = self._env
        rng = stream(1, "equality", episode)
        size = rng.choice([0.0, 0.1, 0.4])
        env.reset(options={"first": episode})
        self._script.restart(np.ones(1, dtype=bool))
        rows: list[np.ndarray] = []
        step = env.actions.step

        def recorded(share: float) -> None:
            step(share)
            rows.append(np.r_[env.actions.target[0], env.actions.opening[0]].astype(np.float32))

        env.actions.step = recorded
        ended = False
        while not ended:
            action = self._script.action()
            action[:, :8] += size * rng.standard_normal(8)
            _, _, terminated, truncated, _ = env.step(action)
            ended = bool(terminated[0] or truncated[0])
        env.actions.step = step
        return np.array(rows)


class Pair:
    """A single environment and a batched one of the same worlds."""

    def __init__(self) -> None:
        self.single = TaskEnv(task="pot_lift")
        self.batched = BatchedEnv(
            1,
            Config(task="pot_lift"),
            action="joint_targets",
            observation=("joints", "grippers"),
            rate_hz=50,
            purpose=PURPOSE,
            supervised=False,
            end_at_violation=False,
            linger_s=0.0,
        )

    def play_batched(self, episode: int, targets: np.ndarray) -> Played:
        env = self.batched
        env.reset(options={"first": episode})
        q = env.worlds.q[0]
        for step, action in enumerate(targets):
            if step == EARLY_STEP:
                q = env.worlds.q[0]
            _, _, terminated, truncated, info = env.step(action[None])
            if terminated[0] or truncated[0]:
                final = {name: values[0] for name, values in info["final_info"].items()}
                failures = () if final["failure"] == "" else (final["failure"],)
                return Played(step, bool(final["success"]), failures, q)
        return Played(len(targets), False, (), q)

    def play_single(self, targets: np.ndarray) -> Played:
        """Play the trial that `play_batched` played last."""
        env = self.single
        trial = self.batched.task.trial(
            self.batched.draws.seed, PURPOSE, self.batched.draws.next_index - 2
        )
        env.reset(options={"trial": trial})
        q = env._world.q
        for step, action in enumerate(targets):
            if step == EARLY_STEP:
                q = env._world.q
            _, _, terminated, truncated, info = env.step(action)
            if terminated or truncated:
                return Played(step, info["success"], tuple(info["failures"]), q)
        return Played(len(targets), False, tuple(env._judge.failures), q)
