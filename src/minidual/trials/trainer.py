"""Trainers of learned methods: their inputs and results."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from minidual.config.root import Config

type Advance = Callable[[int, str], None]
"""Arguments: steps since the last call, and a note for the progress bar."""


class TrainingJob(NamedTuple):
    """Inputs of a training.

    Attributes:
        config: With the task.
        seed: Of this training.
        folder: Existing folder for the checkpoint and the records.
        progress: File that survives an interruption; the trainer goes on from it and removes it.
        advance: Reports progress.
    """

    config: Config
    seed: int
    folder: Path
    progress: Path
    advance: Advance


class TrainingSummary(NamedTuple):
    """Result of a training.

    Attributes:
        steps: Done.
        resumed_from: Step from which an interrupted training went on, or 0.
        numbers: {name with unit: value} for people and records.
        curve: Rows of equal keys: what was measured in the course of the training.
        curve_of: {key of the curve that is drawn: axis label}.
    """

    steps: int
    resumed_from: int
    numbers: Mapping[str, Any]
    curve: Sequence[Mapping[str, Any]]
    curve_of: Mapping[str, str]


class Trainer(Protocol):
    """Trains the policy of a method."""

    def check(self, config: Config) -> None:
        """Raise UsageError or EnvironmentMissingError for a method that cannot be trained."""
        ...

    def steps(self, config: Config) -> int:
        """Return the steps of a training."""
        ...

    def train(self, job: TrainingJob) -> TrainingSummary:
        """Train, and write `job.folder / "checkpoint"`."""
        ...
