"""The trials of a batched environment: drawn one after the other, each with its disturbance."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from minidual.config.root import Config
from minidual.config.seeds import stream
from minidual.tasks.task import Task, Trial

if TYPE_CHECKING:
    import mujoco


class Disturbed(Protocol):
    """A condition that changes the model: a row of `trials.conditions.CONDITIONS`."""

    @property
    def name(self) -> str:
        """Its name, which is part of its random streams'."""
        ...

    @property
    def widen(self) -> float:
        """Scales the range of starts."""
        ...

    def config_under(self, config: Config) -> Config:
        """Return the configuration of its trials."""
        ...

    def applied(
        self, model: mujoco.MjModel, task: Task, trial: Trial, rng: np.random.Generator
    ) -> AbstractContextManager[None]:
        """Change a model, then restore it."""
        ...


class Draw(NamedTuple):
    """A trial, and the random streams of its sensors and its disturbance, as in a benchmark."""

    trial: Trial
    sensing: np.random.Generator
    disturbance: np.random.Generator


class Draws:
    """Draws trials of one random stream in turn.

    Attributes:
        task: Whose trials these are.
        condition: What disturbs them, or None.
        seed, purpose: Of the stream.
        next_index: Number of the next trial.
    """

    def __init__(
        self, task: Task, purpose: str, first: int, condition: Disturbed | None = None
    ) -> None:
        self.task = task
        self.seed = task.config.seed
        self.purpose = purpose
        self.next_index = first
        self.condition = condition

    def next(self) -> Draw:
        """Return the next trial."""
        index = self.next_index
        self.next_index += 1
        condition = self.condition
        widen = 1.0 if condition is None else condition.widen
        name = "clean" if condition is None else condition.name
        return Draw(
            self.task.trial(self.seed, self.purpose, index, widen=widen),
            stream(self.seed, f"sensing/{self.purpose}", index),
            stream(self.seed, f"disturbance/{self.purpose}/{name}", index),
        )
