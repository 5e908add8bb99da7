"""Two-arm manipulation in MuJoCo: plan, carry, teleoperate, record, train, deploy, compare.

The names below are the public surface (docs/python.md). Each is imported when it is first used, so
that `import minidual` stays fast.
"""

import importlib
from typing import TYPE_CHECKING, Any

from minidual.variables import prepare as _prepare

if TYPE_CHECKING:
    from minidual.api.catalogue import list_conditions, list_methods, list_tasks, load_task
    from minidual.api.comparison import Comparison, compare
    from minidual.api.environments import make_env
    from minidual.api.episodes import list_episodes, measure_episode, open_episode, record_episodes
    from minidual.api.planning import Plan, Planner, load_scene
    from minidual.api.policies import load_policy
    from minidual.api.trials import Trials, run_trials
    from minidual.collision.errors import PlanningError
    from minidual.collision.scene import PlanningScene as Scene
    from minidual.collision.shapes import Box, Capsule, Cylinder, Sphere
    from minidual.demos.episode import Episode
    from minidual.demos.quality import EpisodeQuality
    from minidual.errors import DataError, MinidualError, UsageError
    from minidual.motion.goal import Goal
    from minidual.robot.trajectory import Trajectory
    from minidual.tasks.task import Task
    from minidual.trials.metrics import TrialMetrics

_prepare()

__version__ = "0.1.0"

__all__ = [
    "Box",
    "Capsule",
    "Comparison",
    "Cylinder",
    "DataError",
    "Episode",
    "EpisodeQuality",
    "Goal",
    "MinidualError",
    "Plan",
    "Planner",
    "PlanningError",
    "Scene",
    "Sphere",
    "Task",
    "Trajectory",
    "TrialMetrics",
    "Trials",
    "UsageError",
    "compare",
    "list_conditions",
    "list_episodes",
    "list_methods",
    "list_tasks",
    "load_policy",
    "load_scene",
    "load_task",
    "make_env",
    "measure_episode",
    "open_episode",
    "record_episodes",
    "run_trials",
]

_TARGETS = {
    "Box": ("minidual.collision.shapes", "Box"),
    "Capsule": ("minidual.collision.shapes", "Capsule"),
    "Comparison": ("minidual.api.comparison", "Comparison"),
    "Cylinder": ("minidual.collision.shapes", "Cylinder"),
    "DataError": ("minidual.errors", "DataError"),
    "Episode": ("minidual.demos.episode", "Episode"),
    "EpisodeQuality": ("minidual.demos.quality", "EpisodeQuality"),
    "Goal": ("minidual.motion.goal", "Goal"),
    "MinidualError": ("minidual.errors", "MinidualError"),
    "Plan": ("minidual.api.planning", "Plan"),
    "Planner": ("minidual.api.planning", "Planner"),
    "PlanningError": ("minidual.collision.errors", "PlanningError"),
    "Scene": ("minidual.collision.scene", "PlanningScene"),
    "Sphere": ("minidual.collision.shapes", "Sphere"),
    "Task": ("minidual.tasks.task", "Task"),
    "Trajectory": ("minidual.robot.trajectory", "Trajectory"),
    "TrialMetrics": ("minidual.trials.metrics", "TrialMetrics"),
    "Trials": ("minidual.api.trials", "Trials"),
    "UsageError": ("minidual.errors", "UsageError"),
    "compare": ("minidual.api.comparison", "compare"),
    "list_conditions": ("minidual.api.catalogue", "list_conditions"),
    "list_episodes": ("minidual.api.episodes", "list_episodes"),
    "list_methods": ("minidual.api.catalogue", "list_methods"),
    "list_tasks": ("minidual.api.catalogue", "list_tasks"),
    "load_policy": ("minidual.api.policies", "load_policy"),
    "load_scene": ("minidual.api.planning", "load_scene"),
    "load_task": ("minidual.api.catalogue", "load_task"),
    "make_env": ("minidual.api.environments", "make_env"),
    "measure_episode": ("minidual.api.episodes", "measure_episode"),
    "open_episode": ("minidual.api.episodes", "open_episode"),
    "record_episodes": ("minidual.api.episodes", "record_episodes"),
    "run_trials": ("minidual.api.trials", "run_trials"),
}
"""{public name: (module, attribute)}.

As pairs: what a stage reaches is followed through texts of the form "module:attribute", and no stage
reaches the public surface.
"""


def __getattr__(name: str) -> Any:
    """Import a public name at its first use (PEP 562)."""
    target = _TARGETS.get(name)
    if target is None:
        raise AttributeError(f"module 'minidual' has no attribute '{name}'")
    module, attribute = target
    value = getattr(importlib.import_module(module), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
