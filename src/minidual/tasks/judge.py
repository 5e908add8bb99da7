"""Judge of a trial: evaluates the conditions of success."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from minidual.tasks.task import Task, Trial, placement
from minidual.tasks.truth import GroundTruth, Truth

if TYPE_CHECKING:  # the judge of a batch imports no MuJoCo
    from minidual.plant.bodies import ObjectPose

REST_S = 0.1
"""Conditions must hold this long: an object released in the air rests for an instant too."""


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
        return "" if first is None else f"{first.detail}, at {first.at_s:.2f} s"

    def number(self, name: str) -> float:
        """Return a number of `measured`; NaN if no condition gives it."""
        return self.measured.get(name, math.nan)


class Resettable(GroundTruth, Protocol):
    """A simulated world that can be put at a trial's start."""

    def reset(self, *, poses: Mapping[str, ObjectPose]) -> None:
        """Put the arms at home, hands open, and objects at poses."""
        ...


def begin(
    world: Resettable,
    task: Task,
    trial: Trial,
    demanding: Collection[str] = (),
) -> Judge:
    """Mark a trial's goal, reset a simulated world to its start and return its judge."""
    world.mark_goal(*placement(trial.goal[task.carried]))  # what draws the world sees the mark
    world.reset(poses=trial.start)
    return _judge(world, task, trial, demanding)


def begin_here(
    ground: GroundTruth,
    task: Task,
    trial: Trial,
    demanding: Collection[str] = (),
) -> Judge:
    """Mark a trial's goal and return its judge; arms and objects are where they are."""
    ground.mark_goal(*placement(trial.goal[task.carried]))
    return _judge(ground, task, trial, demanding)


def _judge(ground: GroundTruth, task: Task, trial: Trial, demanding: Collection[str]) -> Judge:
    judge = Judge(task, trial, demanding)
    judge.truth.began_s = ground.time
    return judge


class Judge:
    """Watches one trial; call `observe` after every physics step.

    Conditions in `demanding` must hold even if optional.

    Raises:
        ValueError: Two conditions share a name.
    """

    def __init__(self, task: Task, trial: Trial, demanding: Collection[str] = ()) -> None:
        self.trial = trial
        self._conditions = task.success(task, trial)
        names = [condition.name for condition in self._conditions]
        if len(set(names)) < len(names):
            raise ValueError(
                f"task '{task.name}' has two conditions of one name: {', '.join(names)}",
            )
        self.truth = Truth(task.scene.objects)
        """As it was observed last."""
        self._muted = {
            condition.name
            for condition in self._conditions
            if condition.optional and condition.name not in demanding
        }
        # Bound methods of the parts that do something, looked up once: they run at every step.
        self._observing = [
            (part.observe, condition.name, prefix)
            for condition in self._conditions
            for prefix, part in condition.each()
            if part.has("observe")
        ]
        self._final = [
            part.holds
            for condition in self._conditions
            for _, part in condition.each()
            if part.has("holds")
        ]
        self._stages = [condition for condition in self._conditions if condition.stage]
        self._stages_ahead = self._stages.copy()
        self.failures: dict[str, Failure] = {}
        """Violations so far, by name."""
        self._quiet_since_s: float | None = None
        self._done_at_s: float | None = None

    @property
    def finished(self) -> bool:
        """Whether the final conditions have held for `REST_S`."""
        return self._done_at_s is not None

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages reached."""
        reached_n = len(self._stages) - len(self._stages_ahead)
        return tuple(stage.name for stage in self._stages[:reached_n])

    def observe(self, ground: GroundTruth) -> None:
        """Evaluate the state."""
        truth = self.truth
        truth.refresh(ground)
        now_s = truth.time
        for observe, name, prefix in self._observing:
            detail = observe(truth)
            if detail and name not in self._muted:
                self.failures.setdefault(name, Failure(name, now_s, prefix + detail))
        while self._stages_ahead and self._stages_ahead[0].reached(truth):
            self._stages_ahead.pop(0)
        if not self._final_state_holds():
            self._quiet_since_s = None
            self._done_at_s = None
        elif self._quiet_since_s is None:
            self._quiet_since_s = now_s
        elif self._done_at_s is None and now_s - self._quiet_since_s >= REST_S:
            self._done_at_s = now_s

    def _final_state_holds(self) -> bool:
        for place, holds in enumerate(self._final):
            if not holds(self.truth):
                # Evaluate it first from here on: it is likely to fail at the next step too.
                self._final.insert(0, self._final.pop(place))
                return False
        return True

    def disturbed(self) -> None:
        """Tell that somebody has just moved or pushed an object."""
        for condition in self._conditions:
            condition.disturbed()

    def outcome(self, ground: GroundTruth) -> Outcome:
        """Return the verdict."""
        truth = self.truth
        truth.refresh(ground)
        truth.duration_s = truth.time if self._done_at_s is None else self._done_at_s
        failures = dict(self.failures)
        measured = {"progress": len(self.stages) / max(1, len(self._stages))}
        for condition in self._conditions:
            measured.update(condition.measured(truth))
            detail = condition.end(truth)
            if detail and condition.name not in self._muted:
                failures.setdefault(condition.name, Failure(condition.name, truth.time, detail))
        success = self.finished and not failures
        return Outcome(success, tuple(failures.values()), truth.duration_s, measured)
