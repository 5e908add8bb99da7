"""The reference of the Python surface, from docstrings."""

from types import ModuleType

import minidual

_GROUPS = {
    "Planning": ("Planner", "Plan", "Trajectory", "load_scene", "Scene", "Goal"),
    "Obstacles": ("Box", "Cylinder", "Capsule", "Sphere"),
    "Trials": ("run_trials", "Trials", "TrialMetrics", "compare", "Comparison"),
    "What there is": ("list_tasks", "list_methods", "list_conditions", "load_task", "Task"),
    "Episodes": (
        "open_episode",
        "Episode",
        "list_episodes",
        "measure_episode",
        "EpisodeQuality",
        "record_episodes",
    ),
    "Environments and policies": ("make_env", "load_policy"),
    "Errors": ("MinidualError", "UsageError", "DataError", "PlanningError"),
}
_BEHIND = {
    "make_env": "minidual.environments.task_env.TaskEnv",
    "load_policy": "minidual.policies.policy.PolicyRuntime",
}
"""What a function returns that has no public name."""


def surface_reference(module: ModuleType = minidual) -> str:
    """Return the page of all public names.

    Raises:
        ValueError: A public name is in no group.
    """
    grouped = {name for names in _GROUPS.values() for name in names}
    if grouped != set(module.__all__):
        raise ValueError(f"public names and groups differ: {grouped ^ set(module.__all__)}")
    lines = [
        "# Python API",
        "",
        "All names are imported from `minidual`. The [guide](../docs/python.md) shows them at work.",
    ]
    for title, names in _GROUPS.items():
        lines += ["", f"## {title}"]
        for name in names:
            lines += ["", *_entry(name, getattr(module, name))]
            if name in _BEHIND:
                lines += ["", f"::: {_BEHIND[name]}", *_options(_BEHIND[name].split(".")[-1])]
    return "\n".join(lines) + "\n"


def _entry(name: str, thing: type) -> list[str]:
    return [f"::: {thing.__module__}.{thing.__qualname__}", *_options(name)]


def _options(name: str) -> list[str]:
    return ["    options:", f"        heading: {name}", f"        toc_label: {name}"]
