"""Trials of a mating that are only played: trunks of the test's own process, with scripted ends."""

from __future__ import annotations

from multiprocessing.connection import Connection, Pipe
from typing import Any, NamedTuple

import numpy as np

from minidual.environments.mating import mating_size, mating_terms
from minidual.trials.branching import Lost

TERMS = mating_terms()
SIZE = mating_size(TERMS)


class Played(NamedTuple):
    """How an episode goes: actions until it ends, and whether it is a success or merely late."""

    actions_n: int = 3
    success: bool = True


class PlayedTrunk:
    """A trunk whose copies count actions; the observation tells start, copy and action."""

    def __init__(self, start: Any, played: Played | None) -> None:
        self.start = start
        self.played = played
        self.copies_n = 0
        self.closed = False
        self.pipe: Connection
        self.pipe, self._far = Pipe()
        self._actions_n = 0

    def wait(self) -> Lost | None:
        return Lost("dropped on the way") if self.played is None else None

    def branch(self) -> None:
        self.copies_n += 1
        self._actions_n = 0
        self._far.send(self._report())

    def send(self, action: Any) -> None:
        assert np.asarray(action).shape == (5,)
        self._actions_n += 1
        self._far.send(self._report())

    def receive(self) -> Any:
        return self.pipe.recv()

    def close(self) -> None:
        self.closed = True

    def _report(self) -> Any:
        from minidual.trials.lessons.mating_episode import Report

        played = self.played or Played()
        observation = np.zeros(SIZE, np.float32)
        observation[:3] = self.start.index, self.copies_n, self._actions_n
        over = self._actions_n >= played.actions_n
        return Report(
            observation,
            float(self._actions_n),
            ended=over and played.success,
            late=over and not played.success,
            success=over and played.success,
        )


class PlayedTrunks:
    """Starts played trunks, as `trials.branching.Trunks` does."""

    def __init__(self, plays: dict[int, Played | None] | None = None) -> None:
        self.plays = plays or {}
        self.started: list[PlayedTrunk] = []
        self.kept: dict[Any, PlayedTrunk] = {}

    def start(self, request: Any) -> PlayedTrunk:
        if request in self.kept:
            return self.kept.pop(request)
        trunk = PlayedTrunk(request, self.plays.get(request.index, Played()))
        self.started.append(trunk)
        return trunk

    def keep(self, request: Any, trunk: PlayedTrunk) -> None:
        self.kept[request] = trunk
