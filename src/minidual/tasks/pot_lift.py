"""Pot: both hands lift it by its handles and stand it on a plate."""

from typing import Any

from minidual.config.change import preset
from minidual.config.root import Config
from minidual.config.scene import PartConfig
from minidual.tasks.objects import object_values
from minidual.tasks.rod_carry import carry_task
from minidual.tasks.task import Task

_STEEL, _BLACK = (0.70, 0.72, 0.75, 1.0), (0.12, 0.12, 0.13, 1.0)
_POT: dict[str, Any] = {
    "name": "pot",
    "shape": "cylinder",
    "upright": True,
    "length_m": 0.10,
    "radius_m": 0.085,
    "mass_kg": 1.0,
    "friction": 0.7,
    "grasp_offset_m": 0.13,
    "grasp_height_m": 0.03,
    "colour": (0.78, 0.16, 0.13, 1.0),
    "parts": (
        PartConfig(size_m=(0.03, 0.08, 0.024), position_m=(0.0, 0.118, 0.027), colour=_BLACK),
        PartConfig(size_m=(0.03, 0.08, 0.024), position_m=(0.0, -0.118, 0.027), colour=_BLACK),
        PartConfig(shape="cylinder", size_m=(0.178, 0.178, 0.01), position_m=(0.0, 0.0, 0.055), colour=_STEEL),
        PartConfig(shape="cylinder", size_m=(0.03, 0.03, 0.02), position_m=(0.0, 0.0, 0.07), colour=_BLACK),
    ),
}


def pot_lift(config: Config) -> Task:
    """Return the task."""
    config = preset(
        config,
        {
            **object_values(_POT, 27.0, 500.0, safety=3.0),
            "scene.task.start_xy_m": (0.48, 0.12),
            "scene.task.start_range_m": 0.10,
            "scene.task.start_range_rad": 0.5236,
            "scene.task.goal_xy_m": (0.48, -0.15),
            "scene.task.goal_range_m": 0.03,
            "scene.task.goal_tolerance_m": 0.03,
            "scene.task.clear_height_m": 0.10,
            "scene.task.lift_height_m": 0.12,
        },
    )
    return carry_task("pot_lift", "Lift the pot by both handles and put it on the green plate.", config, "pot-trial")
