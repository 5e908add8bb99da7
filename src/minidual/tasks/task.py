"""Tasks. A row of TASKS builds one from the configuration, so `--set` reaches every number.

Other distributions add rows through the entry point group `minidual.tasks` (docs/howto-task.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from minidual.config.root import Config, changed
from minidual.config.scene import ObjectConfig, SceneConfig
from minidual.config.seeds import stream
from minidual.registry import Registry
from minidual.robot.pair import SIDES, Array
from minidual.tasks.success import SuccessCondition

ObjectPose = Array | tuple[float, float, float]
"""As in minidual.plant.bodies."""
Poses = dict[str, ObjectPose]
"""By object."""


@dataclass(frozen=True)
class Trial:
    """Randomised trial `index` of the random stream `purpose`."""

    purpose: str
    index: int
    start: Mapping[str, ObjectPose]
    goal: Mapping[str, ObjectPose]


@dataclass(frozen=True)
class TaskObject:
    """An object.

    Attributes:
        grasps: T_object_tcp (4, 4) by hand.
        symmetry: Yaws that look alike in a turn: 2 for a rod.
        touches_m: (3,) where it touches others first.
    """

    body: ObjectConfig
    grasps: Mapping[str, Array] = field(default_factory=dict)
    symmetry: int = 1
    touches_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Step:
    """One step of a plan.

    Attributes:
        phase: Row of minidual.skills.phases.
        objects: One for all hands or one a hand; empty for the task's first.
        places: Target poses (4, 4) of the object, or {object: pose}, preferred first; empty for the trial's goals.
        grasps: T_object_tcp (4, 4) of the hand, preferred first; empty for the object's.
    """

    phase: str
    hands: tuple[str, ...] = SIDES
    objects: tuple[str, ...] = ()
    places: tuple[Array | Mapping[str, Array], ...] = ()
    grasps: tuple[Array, ...] = ()


@dataclass(frozen=True)
class Task:
    """A task.

    Attributes:
        instruction: For people and language-conditioned policies.
        objects: By name; the first is carried, disturbed and measured.
        success: (task, trial) -> new conditions.
        draw: (task, rng, widen) -> start and goal, each {object: pose}.
        arrange: (task, trial, sensed poses) -> lists of steps, preferred first, where they depend on the start.
    """

    name: str
    instruction: str
    config: Config
    objects: Mapping[str, TaskObject]
    steps: tuple[Step, ...]
    success: Callable[[Task, Trial], Sequence[SuccessCondition]]
    draw: Callable[[Task, np.random.Generator, float], tuple[Poses, Poses]]
    stream: str = "trial"
    arrange: Callable[[Task, Trial, Mapping[str, Array]], Iterable[Sequence[Step]]] | None = None

    @property
    def scene(self) -> SceneConfig:
        """The scene."""
        return self.config.scene

    @property
    def carried(self) -> str:
        """Name of the first object."""
        return next(iter(self.objects))

    @property
    def together(self) -> bool:
        """Whether both hands hold one object all the way."""
        return bool(self.steps) and all(step.hands == SIDES and len(step.objects) < 2 for step in self.steps)

    @property
    def time_limit_s(self) -> float:
        """Simulated time limit."""
        return self.scene.task.time_limit_s

    def trial(self, seed: int, purpose: str, index: int, *, widen: float = 1.0) -> Trial:
        """Draw a trial; `widen` scales the start's range."""
        start, goal = self.draw(self, stream(seed, f"{self.stream}/{purpose}", index), widen)
        return Trial(purpose, index, start, goal)


TASKS: Registry[Callable[[Config], Task]] = Registry(
    "task",
    {
        "rod_carry": "minidual.tasks.rod_carry:rod_carry",
        "handover": "minidual.tasks.handover:handover",
        "pot_lift": "minidual.tasks.pot_lift:pot_lift",
        "sort": "minidual.tasks.sort:sort",
        "insertion": "minidual.tasks.insertion:insertion",
    },
    group="minidual.tasks",
)


def make_task(config: Config) -> Task:
    """Return the configured task.

    Raises:
        UsageError: Unknown task or refused value.
    """
    return TASKS[config.task](config)


def tasks_of(config: Config) -> dict[str, Task]:
    """Return the benchmark's tasks.

    Raises:
        UsageError: Unknown or repeated name.
    """
    own = tuple(dict.fromkeys((config.task, *config.benchmark.further_tasks)))
    names = TASKS.names(config.benchmark.tasks or own)
    return {name: make_task(config if name == config.task else changed(config, {"task": name})) for name in names}


def task_config(config: Config) -> Config:
    """Return the configuration with the task's values; idempotent."""
    return make_task(config).config


def benchmark_config(config: Config) -> Config:
    """Return `task_config`; several tasks are resolved when they run."""
    return config if config.benchmark.tasks or config.benchmark.further_tasks else task_config(config)
