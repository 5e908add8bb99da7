"""The kinds of stages, and what they work with."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from minidual.collision.errors import PlanningError
from minidual.collision.scene import PlanningScene
from minidual.motion.api import Planner
from minidual.motion.closed_chain import CarriedPlanner
from minidual.motion.goals import PoseGoals
from minidual.motion.held_planner import HeldPlanner
from minidual.motion.linear import LinearPlanner
from minidual.robot.constants import ARMS
from minidual.robot.kinematics import Kinematics
from minidual.skills.pipeline.state import Segment, State, TaskObject, scene_of


@dataclass(frozen=True)
class Failure:
    """Why one candidate came to nothing: a short word to count by, and the message with names and numbers."""

    reason: str
    message: str


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way through a stage.

    Attributes:
        label: What distinguishes it, for people.
        cost: Preference; the sum over the stages orders the search.
        start, end: Interface states; a generator's are the same.
        segments: What is driven from start to end.
    """

    label: str
    cost: float
    start: State
    end: State
    segments: tuple[Segment, ...] = ()


Offer = Candidate | Failure
"""What a stage yields, one after the other, the preferred ones first."""


@dataclass
class Tools:
    """Planners and scene that all stages of one search share.

    Attributes:
        around: What stands there beside the object.
        thing: The object.
        planner: Free motions.
        seed: Of every random choice.
    """

    around: PlanningScene
    thing: TaskObject
    planner: Planner
    seed: int = 0
    linear: LinearPlanner = field(default_factory=LinearPlanner)
    carrier: CarriedPlanner = field(default_factory=CarriedPlanner)
    holder: HeldPlanner = field(default_factory=HeldPlanner)
    poses: PoseGoals = field(default_factory=PoseGoals)
    kinematics: Kinematics = field(default_factory=Kinematics)

    def scene(self, state: State, *, touching: tuple[str, ...] = (), resting: bool = False) -> PlanningScene:
        """Return the planning scene of a state; see `scene_of`."""
        return scene_of(self.around, self.thing, state, touching=touching, resting=resting)

    def rng(self, *key: int) -> np.random.Generator:
        """Return a generator of random numbers of its own for one purpose."""
        return np.random.default_rng([self.seed, *key])


class Stage(ABC):
    """One step of a task; its kind says which states it is given."""

    def __init__(self, name: str) -> None:
        self.name = name

    @abstractmethod
    def offers(self, *args: Any) -> Iterator[Offer]:
        """Yield candidates and failures, the preferred candidates first."""


class Generator(Stage):
    """Makes states out of nothing but the start of the task: grasps, goals."""

    @abstractmethod
    def offers(self, first: State, tools: Tools) -> Iterator[Offer]:
        """Yield candidates whose start and end are the state made."""


class Forward(Stage):
    """Goes on from the state before it."""

    @abstractmethod
    def offers(self, start: State, tools: Tools) -> Iterator[Offer]:
        """Yield candidates that begin at `start`."""


class Backward(Stage):
    """Leads up to the state after it."""

    @abstractmethod
    def offers(self, end: State, tools: Tools) -> Iterator[Offer]:
        """Yield candidates that end at `end`."""


class Connector(Stage):
    """Joins the states before and after it; planned last, because it costs most and fails least."""

    @abstractmethod
    def offers(self, start: State, end: State, tools: Tools) -> Iterator[Offer]:
        """Yield candidates from `start` to `end`."""


def failure(error: PlanningError) -> Failure:
    """Return the failure that an error of a planner stands for."""
    return Failure(error.reason, error.message)


def group_of(arms: tuple[str, ...] | Mapping[str, object]) -> str:
    """Return the planning group that moves these arms."""
    named = [arm for arm in ARMS if arm in arms]
    return "both_arms" if len(named) == len(ARMS) else f"{named[0]}_arm"
