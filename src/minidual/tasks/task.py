"""What is to be done: objects, where they start and must end, phases, and the conditions of success. TASKS lists them.

A row is a function that builds a task from the configuration, so that `--set` reaches every number of it. Other
distributions add rows through the entry point group `minidual.tasks`; docs/howto-task.md shows how.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from minidual.config.root import Config
from minidual.config.scene import ObjectConfig, SceneConfig
from minidual.config.seeds import stream
from minidual.registry import Registry
from minidual.robot.pair import SIDES, Array
from minidual.tasks.success import SuccessCondition

ObjectPose = Array | tuple[float, float, float]
"""Where an object is put: a pose (4, 4), or (x, y, yaw) [m, m, rad] resting on the table."""


@dataclass(frozen=True)
class Trial:
    """One randomised trial.

    Attributes:
        purpose: Name of its random stream, e.g. `carry` or `demonstrations`.
        index: Its number in that stream.
        start: Where each object starts, by name: (x [m], y [m], yaw [rad]) on the table, or a pose (4, 4).
        goal: Where objects must be put down, likewise.
    """

    purpose: str
    index: int
    start: Mapping[str, ObjectPose]
    goal: Mapping[str, ObjectPose]


@dataclass(frozen=True)
class TaskObject:
    """An object of a task.

    Attributes:
        body: Shape, mass, friction, colour; its name is the body's.
        grasps: T_object_tcp (4, 4) by hand ("left", "right"); a hand without one does not grasp it.
    """

    body: ObjectConfig
    grasps: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Step:
    """One step of a task's plan, for who solves it phase by phase.

    Attributes:
        phase: Row of the phase table (minidual.skills).
        hands: Which hands do it.
        object: Name of the object; empty for the task's first.
        places: Poses (4, 4) in the world to bring it to in this step, the preferred one first; none for the trial's goal.
    """

    phase: str
    hands: tuple[str, ...] = SIDES
    object: str = ""
    places: tuple[Array, ...] = ()


@dataclass(frozen=True)
class Task:
    """What is to be done and how it is judged.

    Attributes:
        name: Row of TASKS.
        instruction: One sentence, as a person or a language-conditioned policy reads it.
        config: The configuration with every value that the task stands for; `config.scene` is its world.
        objects: By name; the first is the one that is carried, disturbed and measured.
        steps: Plan in phases.
        success: Called with the task and a trial; returns new conditions of success for it.
        draw: Called with (task, rng, widen); returns start and goal of a trial, each {object: pose}.
        stream: Name under which its trials are drawn.
    """

    name: str
    instruction: str
    config: Config
    objects: Mapping[str, TaskObject]
    steps: tuple[Step, ...]
    success: Callable[[Task, Trial], Sequence[SuccessCondition]]
    draw: Callable[[Task, np.random.Generator, float], tuple[dict[str, ObjectPose], dict[str, ObjectPose]]]
    stream: str = "trial"

    @property
    def scene(self) -> SceneConfig:
        """The world in which it is done."""
        return self.config.scene

    @property
    def carried(self) -> str:
        """Name of the first object."""
        return next(iter(self.objects))

    @property
    def time_limit_s(self) -> float:
        """Simulated time that a trial may take [s]."""
        return self.scene.task.time_limit_s

    def trial(self, seed: int, purpose: str, index: int, *, widen: float = 1.0) -> Trial:
        """Draw trial `index` of a purpose; different purposes never share trials.

        Args:
            seed: The run's seed.
            purpose: Name of the random stream.
            index: Trial number.
            widen: Scale of the start's range; demonstrations may cover more than the tests ask.
        """
        start, goal = self.draw(self, stream(seed, f"{self.stream}/{purpose}", index), widen)
        return Trial(purpose, index, start, goal)


TASKS: Registry[Callable[[Config], Task]] = Registry(
    "task",
    {"rod_carry": "minidual.tasks.rod_carry:rod_carry", "handover": "minidual.tasks.handover:handover"},
    group="minidual.tasks",
)


def make_task(config: Config) -> Task:
    """Return the task that the configuration names.

    Raises:
        UsageError: There is no such task, or it refuses a value.
    """
    return TASKS[config.task](config)


def task_config(config: Config) -> Config:
    """Return the configuration with every value that its task stands for; twice changes nothing."""
    return make_task(config).config
