"""Matings side by side, as a Gymnasium vector environment.

Each world owns a trunk: a trial that waits where the policy takes over. An episode is a copy of it.
After some episodes the world takes a trunk of the next start.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from multiprocessing.connection import wait
from typing import Any, ClassVar, NamedTuple

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from minidual.environments.mating import RelativePose, mating_size
from minidual.environments.observations import CLIP
from minidual.errors import DataError, UsageError
from minidual.robot.pair import Array
from minidual.trials.branching import Lost, Trunk, Trunks
from minidual.trials.lessons.mating_episode import Report, Start

_LOST_MAX = 50
"""Trials in turn that may end before their mating."""

type Floats = npt.NDArray[np.float32]
type Flags = npt.NDArray[np.bool_]


class _Started(NamedTuple):
    """A trial on its way to its branch point, or there."""

    start: Start
    trunk: Trunk


class _World:
    """One world: its trial, the next one, and the episode under way."""

    def __init__(self, condition: str, episodes_before: int) -> None:
        self.condition = condition
        self.trial: _Started | None = None
        self.next: _Started | None = None
        self.episodes = episodes_before
        """Of the present trial. The first ones have fewer, so that not all end at once."""
        self.resting = False
        """Whether its only episode has ended."""


class MatingWorlds(gymnasium.vector.VectorEnv[Floats, Floats, Array]):
    """N matings; episodes that end begin anew within the same step (SAME_STEP).

    Observation: (N, k) float32, terms of `environments.mating`. Action: (N, 5) in -1..1.
    `final_info["success"]` (N,) tells whether an episode that ended succeeded.

    Args:
        trunks: Of the trials.
        conditions: Of the trials of each world.
        purpose: Random stream of the trials.
        terms: Of the observation.
        episodes: Of a trunk.
        workers: Worlds that compute at the same time.
        once: Whether a world rests after its first episode.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": [],
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    # All but the first four are options.
    def __init__(
        self,
        trunks: Trunks,
        conditions: Sequence[str],
        purpose: str,
        terms: Sequence[str],
        *,
        episodes: int = 4,
        workers: int = 2,
        once: bool = False,
    ) -> None:
        self._trunks = trunks
        self._purpose = purpose
        self._episodes = episodes
        self._workers = workers
        self._once = once
        self._conditions = list(conditions)
        self._worlds = self._fresh_worlds()
        self._next_index = 0
        self.lost_n = 0
        """Trials so far that ended before their mating."""
        self.num_envs = len(self._worlds)
        actions_n = len(RelativePose.names)
        self.single_observation_space = spaces.Box(-CLIP, CLIP, (mating_size(terms),), np.float32)
        self.single_action_space = spaces.Box(-1.0, 1.0, (actions_n,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._latest = np.zeros((self.num_envs, mating_size(terms)), np.float32)

    def reset(
        self,
        *,
        seed: Any = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode in every world, each from a trial that no earlier one began from.

        Raises:
            DataError: Trial after trial ends before its mating.
        """
        self._leave_trials()
        self._worlds = self._fresh_worlds()
        waiting = deque(enumerate(self._worlds))
        for _ in range(self._workers):
            self._prepare_one(waiting)
        for number, world in enumerate(self._worlds):
            self._begin(number, world)
            self._prepare_one(waiting)
        return self._latest.copy(), {}

    def step(self, actions: npt.ArrayLike) -> tuple[Floats, Array, Flags, Flags, dict[str, Any]]:
        """Hold actions (N, 5) for a tenth of a second.

        Raises:
            UsageError: Wrong shape, or not finite.
        """
        action = np.asarray(actions, dtype=float)
        if action.shape != self.action_space.shape or not np.isfinite(action).all():
            raise UsageError(f"actions are {self.action_space.shape} finite numbers")
        reports = self._exchanged(action)
        rewards = np.zeros(self.num_envs)
        terminated = np.zeros(self.num_envs, dtype=bool)
        truncated = np.zeros(self.num_envs, dtype=bool)
        success = np.zeros(self.num_envs, dtype=bool)
        for number, report in reports.items():
            self._latest[number] = report.observation
            rewards[number] = report.reward
            terminated[number] = report.ended
            truncated[number] = report.late
            success[number] = report.success
        last = self._latest.copy()
        for number in np.flatnonzero(terminated | truncated).tolist():
            world = self._worlds[number]
            if self._once:
                world.resting = True
            else:
                self._begin(number, world)
        infos = {"final_obs": last, "final_info": {"success": success}}
        return self._latest.copy(), rewards, terminated, truncated, infos

    def close_extras(self, **kwargs: Any) -> None:
        """End all trunks."""
        self._leave_trials()

    # Episodes ----------------------------------------------------------------------------------

    def _fresh_worlds(self) -> list[_World]:
        return [
            _World(condition, number % self._episodes)
            for number, condition in enumerate(self._conditions)
        ]

    def _leave_trials(self) -> None:
        """Give back the trunks whose copy has ended; end the others."""
        for world in self._worlds:
            if world.trial is not None and world.resting:
                self._trunks.keep(*world.trial)
            elif world.trial is not None:
                world.trial.trunk.close()
            if world.next is not None:
                world.next.trunk.close()

    def _exchanged(self, actions: Array) -> dict[int, Report]:
        """Give each world its action; return the results of those that do not rest."""
        waiting = deque(
            (number, trunk) for number, trunk in self._present() if not self._worlds[number].resting
        )
        computing: dict[Any, tuple[int, Trunk]] = {}
        reports: dict[int, Report] = {}
        while waiting or computing:
            while waiting and len(computing) < self._workers:
                number, trunk = waiting.popleft()
                trunk.send(actions[number])
                computing[trunk.pipe] = (number, trunk)
            for pipe in wait(list(computing)):
                number, trunk = computing.pop(pipe)
                reports[number] = trunk.receive()
        return reports

    def _present(self) -> Iterable[tuple[int, Trunk]]:
        for number, world in enumerate(self._worlds):
            if world.trial is None:
                raise UsageError("the worlds were stepped before they were reset")
            yield number, world.trial.trunk

    def _begin(self, number: int, world: _World) -> None:
        """Begin the next episode of a world."""
        if world.trial is not None and world.episodes >= self._episodes:
            world.trial.trunk.close()
            world.trial = None
            world.episodes = 0
        if world.trial is None:
            world.trial = self._arrived(world)
        world.episodes += 1
        if world.episodes >= self._episodes and not self._once:
            world.next = self._started(world)
        trunk = world.trial.trunk
        trunk.branch()
        self._latest[number] = trunk.receive().observation

    def _arrived(self, world: _World) -> _Started:
        """Return a trial that waits at its branch point: the next one, or a later one.

        Raises:
            DataError: Trial after trial ends before its mating.
        """
        reason = ""
        for _ in range(_LOST_MAX):
            trial = world.next
            world.next = None
            if trial is None:
                trial = self._started(world)
            lost: Lost | None = trial.trunk.wait()
            if lost is None:
                return trial
            self.lost_n += 1
            reason = lost.reason
            if self._once:  # asked for again by the next worlds of this purpose
                self._trunks.keep(*trial)
            else:
                trial.trunk.close()
        raise DataError(f"{_LOST_MAX} trials ended before their mating; the last one: {reason}")

    def _started(self, world: _World) -> _Started:
        start = Start(world.condition, self._purpose, self._next_index)
        self._next_index += 1
        return _Started(start, self._trunks.start(start))

    def _prepare_one(self, waiting: deque[tuple[int, _World]]) -> None:
        """Start the next world's first trial, while others are waited for."""
        if waiting:
            _, world = waiting.popleft()
            world.next = self._started(world)
