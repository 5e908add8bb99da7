"""The table of tasks. A row builds a task from the configuration, so `--set` reaches every number.

Other distributions add rows through the entry point group `minidual.tasks` (docs/howto-task.md).
"""

from collections.abc import Callable

from pydantic import ValidationError

from minidual.config.root import Config, changed
from minidual.errors import UsageError
from minidual.registry import Registry
from minidual.tasks.handover import handover
from minidual.tasks.insertion import insertion
from minidual.tasks.pot_lift import pot_lift
from minidual.tasks.rod_carry import rod_carry
from minidual.tasks.sort import sort
from minidual.tasks.task import Task

TASKS: Registry[Callable[[Config], Task]] = Registry(
    "task",
    {
        "handover": handover,
        "insertion": insertion,
        "pot_lift": pot_lift,
        "rod_carry": rod_carry,
        "sort": sort,
    },
    group="minidual.tasks",
)


def make_task(config: Config) -> Task:
    """Return the configured task.

    Raises:
        UsageError: Unknown task, refused value, or values that do not go together in this task.
    """
    task = TASKS[config.task]
    try:
        return task(config)
    except ValidationError as error:
        reason = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise UsageError(
            f"task '{config.task}' cannot have the values that are set: {reason}",
            remedy="leave out what was set of scene.object, or choose other tasks",
        ) from error


def tasks_of(config: Config) -> dict[str, Task]:
    """Return the benchmark's tasks by name.

    Raises:
        UsageError: Unknown or repeated name.
    """
    run_and_further = dict.fromkeys((config.task, *config.benchmark.further_tasks))
    tasks: dict[str, Task] = {}
    for name in TASKS.names(config.benchmark.tasks or tuple(run_and_further)):
        own = config if name == config.task else changed(config, {"task": name})
        tasks[name] = make_task(own)
    return tasks


def task_config(config: Config) -> Config:
    """Return the configuration with the task's values; idempotent."""
    return make_task(config).config


def benchmark_config(config: Config) -> Config:
    """Return `task_config`; several tasks are resolved when they run."""
    if config.benchmark.tasks or config.benchmark.further_tasks:
        return config
    return task_config(config)
