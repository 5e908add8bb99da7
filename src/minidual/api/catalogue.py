"""Tasks, methods and conditions by name."""

from minidual.api.settings import Settings, configured
from minidual.tasks.catalogue import TASKS, make_task
from minidual.tasks.task import Task
from minidual.trials.conditions import CONDITIONS
from minidual.trials.methods import METHODS


def load_task(name: str, *, settings: Settings | None = None) -> Task:
    """Return a task: its instruction, objects, success conditions and random starts.

    Args:
        name: One of `list_tasks()`.
        settings: {dotted path: value} of the configuration, like `--set`.

    Raises:
        UsageError: Unknown name, or a value that the task refuses.
    """
    return make_task(configured(name, settings))


def list_tasks() -> dict[str, str]:
    """Return {name: instruction} of every task, plug-ins included."""
    return {name: load_task(name).instruction for name in TASKS}


def list_methods() -> dict[str, str]:
    """Return {name: summary} of every method, plug-ins included."""
    return {name: METHODS[name].summary for name in METHODS}


def list_conditions() -> dict[str, str]:
    """Return {name: summary} of every condition; "clean" disturbs nothing."""
    return {name: CONDITIONS[name].summary for name in CONDITIONS}
