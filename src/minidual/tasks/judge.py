"""Judge of a trial: evaluates the conditions of success."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from minidual.plant.world import World
from minidual.tasks.success import Truth
from minidual.tasks.task import Task, Trial, placement

REST_S = 0.1
"""Conditions must hold this long: an object let go in the air rests for an instant too."""


@dataclass(frozen=True)
class Failure:
    """A violated condition, and when it first was violated."""

    name: str
    at_s: float
    detail: str


@dataclass(frozen=True)
class Outcome:
    """The result.

    Attributes:
        success: Finished without violation.
        failures: Violations, each at its first instant.
        duration_s: Time of the finish, else of the end.
        measured: The conditions' numbers, and `progress`, the share of stages reached.
    """

    success: bool
    failures: tuple[Failure, ...]
    duration_s: float
    measured: Mapping[str, float]

    @property
    def reason(self) -> str:
        """The first violation as one line."""
        first = min(self.failures, key=lambda f: f.at_s, default=None)
        return "" if first is None else f"{first.name} at {first.at_s:.2f} s: {first.detail}"

    def number(self, name: str) -> float:
        """Return a number of `measured`; NaN if no condition gives it."""
        return self.measured.get(name, math.nan)


def begin(
    world: World,
    task: Task,
    trial: Trial,
    demanding: Collection[str] = (),
    *,
    reset: bool = True,
) -> Judge:
    """Mark a trial's goal, reset the world to its start and return its judge."""
    world.mark_goal(*placement(trial.goal[task.carried]))
    if reset:
        world.reset(poses=trial.start)
    return Judge(task, trial, demanding)


class Judge:
    """Watches one trial; call `observe` after every physics step.

    Conditions in `demanding` must hold even if optional.

    Raises:
        ValueError: Two conditions share a name.
    """

    def __init__(self, task: Task, trial: Trial, demanding: Collection[str] = ()) -> None:
        self.trial = trial
        self._conditions = task.success(task, trial)
        names = [c.name for c in self._conditions]
        if len(set(names)) < len(names):
            raise ValueError(
                f"task '{task.name}' has two conditions of one name: {', '.join(names)}",
            )
        self.truth = Truth(task.scene.objects)
        """As it was observed last."""
        self._muted = {c.name for c in self._conditions if c.optional and c.name not in demanding}
        parts = [(part, (c.name, of)) for c in self._conditions for of, part in c.each()]
        self._observing = [(part.observe, told) for part, told in parts if part.has("observe")]
        self._final = [part.holds for part, _ in parts if part.has("holds")]
        self._stages = [c for c in self._conditions if c.stage]
        self._ahead = self._stages.copy()
        self.failures: dict[str, Failure] = {}
        """Violations so far, by name."""
        self._quiet_since: float | None = None
        self._done_at: float | None = None

    @property
    def finished(self) -> bool:
        """Whether the final conditions have held for `REST_S`."""
        return self._done_at is not None

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages reached."""
        return tuple(c.name for c in self._stages[: len(self._stages) - len(self._ahead)])

    def observe(self, world: World) -> None:
        """Evaluate the state."""
        truth = self.truth
        truth.refresh(world)
        now = truth.time
        for observe, told in self._observing:
            if detail := observe(truth):
                name, of = told
                if name not in self._muted:
                    self.failures.setdefault(name, Failure(name, now, of + detail))
        while self._ahead and self._ahead[0].reached(truth):
            self._ahead.pop(0)
        for holds in (final := self._final):
            if not holds(truth):
                if holds is not final[0]:  # ask it first from now on: it is likely to fail again
                    final.insert(0, final.pop(final.index(holds)))
                self._quiet_since = self._done_at = None
                return
        if self._quiet_since is None:
            self._quiet_since = now
        elif self._done_at is None and now - self._quiet_since >= REST_S:
            self._done_at = now

    def disturbed(self) -> None:
        """Tell that somebody has just moved or pushed an object."""
        for condition in self._conditions:
            condition.disturbed()

    def outcome(self, world: World) -> Outcome:
        """Return the verdict."""
        truth = self.truth
        failures = dict(self.failures)
        truth.refresh(world)
        truth.duration_s = truth.time if self._done_at is None else self._done_at
        measured = {"progress": len(self.stages) / max(1, len(self._stages))}
        for condition in self._conditions:
            measured.update(condition.measured(truth))
            detail = condition.end(truth)
            if detail and condition.name not in self._muted:
                failures.setdefault(condition.name, Failure(condition.name, truth.time, detail))
        done = self._done_at is not None
        return Outcome(done and not failures, tuple(failures.values()), truth.duration_s, measured)
