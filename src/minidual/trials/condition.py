"""A condition of a trial: its changes, and the methods to which it applies."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from operator import attrgetter
from typing import TYPE_CHECKING, Protocol

import numpy as np
from pydantic import ValidationError

from minidual.config.root import Config, changed
from minidual.errors import UsageError
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Task, Trial
from minidual.trials.methods import METHODS, SENSES

if TYPE_CHECKING:  # the table must be readable without importing MuJoCo
    import mujoco

    from minidual.plant.simulation import Simulation


class Disturbance(Protocol):
    """Acts on the world after every step."""

    took_place: bool
    """Whether it has acted completely."""

    def __call__(self, world: Simulation) -> None:
        """Act or wait."""


type Change = Callable[[mujoco.MjModel, Task, Trial, np.random.Generator], None]
"""Changes the compiled model."""


@dataclass(frozen=True)
class Condition:
    """One row of the table.

    Attributes:
        act: Makes the disturbance of a trial.
        instead_of: What `change` sets, {dotted path: value}.
        settings: Sets {dotted path: value}.
        factors: Scales {dotted path: factor}.
        sense: Row of SENSES that it changes; empty for the plant.
        widen: Scales the range of the start.
        promised: Whether a carry must pass it.
    """

    name: str
    summary: str
    act: Callable[[Task, np.random.Generator], Disturbance] | None = None
    change: Change | None = None
    instead_of: Mapping[str, float] = field(default_factory=dict)
    settings: Mapping[str, float] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    sense: str = ""
    widen: float = 1.0
    promised: bool = True

    def why_not(self, method: str, config: Config) -> str:
        """Return why it does not apply, or an empty string."""
        if self.sense and self.sense not in METHODS[method].reads(make_task(config)):
            return f"{method} reads no {SENSES[self.sense]}"
        values = {**self.instead_of, **self.settings_under(config)}
        does_more_than_set_values = self.change is not None and not self.instead_of
        if not values or does_more_than_set_values:
            return ""
        if all(value == attrgetter(path)(config) for path, value in values.items()):
            same = ", ".join(f"{path} is {value:g}" for path, value in values.items())
            return f"without it too, {same}"
        return ""

    def settings_under(self, config: Config) -> dict[str, float]:
        """Return its changes of `config`, {dotted path: value}."""
        scaled = {path: factor * attrgetter(path)(config) for path, factor in self.factors.items()}
        return {**self.settings, **scaled}

    def config_under(self, config: Config) -> Config:
        """Return the configuration of its trials.

        Raises:
            UsageError: A value is out of bounds.
        """
        values = self.settings_under(config)
        try:
            return changed(config, values)
        except ValidationError as error:
            settings = ", ".join(f"{path} = {value:g}" for path, value in values.items())
            reason = error.errors()[0]["msg"]
            raise UsageError(
                f"condition '{self.name}' sets {settings}: {reason}",
                remedy="leave the condition out, or configure less noise",
            ) from error

    @contextmanager
    def applied(
        self,
        model: mujoco.MjModel,
        task: Task,
        trial: Trial,
        rng: np.random.Generator,
    ) -> Generator[None]:
        """Change a model, then restore it."""
        if self.change is None:
            yield
            return
        originals = [(values, values.copy()) for values in _arrays_of(model)]
        try:
            self.change(model, task, trial, rng)  # inside try: a partial change is undone too
            _derive(model)
            yield
        finally:
            for values, original in originals:
                values[...] = original
            _derive(model)


def _arrays_of(model: mujoco.MjModel) -> list[np.ndarray]:
    """Return every array of a model and of its headlight, as views."""
    arrays: list[np.ndarray] = []
    for owner in (model, model.vis.headlight):
        for name in dir(owner):
            if name.startswith("_"):
                continue
            values = getattr(owner, name)
            if isinstance(values, np.ndarray):
                arrays.append(values)
    return arrays


def _derive(model: mujoco.MjModel) -> None:
    """Update the derived constants of a MuJoCo model."""
    import mujoco

    mujoco.mj_setConst(model, mujoco.MjData(model))
