"""The simulator's class is named by its own files and by what composes a simulation, nowhere else."""

from __future__ import annotations

import ast
from pathlib import Path

import minidual

SOURCE = Path(minidual.__file__).parent
COMPOSE = {
    "demos/rig.py",
    "environments/task_env.py",
    "show/watch_plant.py",
    "skills/held_execution.py",
    "stages/bridge.py",
    "stages/env_check/model.py",
    "stages/env_check/pictures.py",
    "stages/env_check/rig.py",
    "stages/env_check/stage.py",
    "stages/env_check/tracking.py",
    "stages/modes_place.py",
    "stages/plan.py",
    "stages/plan_task.py",
    "stages/scene_view.py",
    "trials/runner.py",
    "trials/site.py",
}
"""Files that make a simulated world, drive it as such, or hand it to a judge."""


def names_world(source: str) -> bool:
    """Return whether a module imports the class `World`."""
    return any(
        isinstance(node, ast.ImportFrom)
        and node.module == "minidual.plant.world"
        and any(alias.name == "World" for alias in node.names)
        for node in ast.walk(ast.parse(source))
    )


def test_what_is_told_apart() -> None:
    assert names_world("from minidual.plant.world import SimulationDivergedError, World")
    assert not names_world("from minidual.plant.world import SimulationDivergedError")


def test_only_the_simulator_and_compositions_name_it() -> None:
    named = {
        path.relative_to(SOURCE).as_posix()
        for path in SOURCE.rglob("*.py")
        if names_world(path.read_text(encoding="utf-8"))
    }
    outside = {name for name in named if not name.startswith("plant/")}
    assert outside == COMPOSE
