"""Pot: both hands lift it by its handles and stand it on a painted mark."""

from minidual.config.root import Config, preset
from minidual.config.scene import PartConfig
from minidual.tasks.objects import with_pinch
from minidual.tasks.rod_carry import carry_task
from minidual.tasks.task import Task

_BLACK = (0.12, 0.12, 0.13, 1.0)
_STEEL = (0.70, 0.72, 0.75, 1.0)
_HANDLE_M = (0.03, 0.08, 0.024)
_PARTS = (
    PartConfig(size_m=_HANDLE_M, position_m=(0.0, 0.118, 0.027), colour=_BLACK),
    PartConfig(size_m=_HANDLE_M, position_m=(0.0, -0.118, 0.027), colour=_BLACK),
    PartConfig(  # the lid
        shape="cylinder",
        size_m=(0.178, 0.178, 0.01),
        position_m=(0.0, 0.0, 0.055),
        colour=_STEEL,
    ),
    PartConfig(  # its knob
        shape="cylinder",
        size_m=(0.03, 0.03, 0.02),
        position_m=(0.0, 0.0, 0.07),
        colour=_BLACK,
    ),
)
_VALUES = with_pinch(
    {
        "scene.object.name": "pot",
        "scene.object.shape": "cylinder",
        "scene.object.upright": True,
        "scene.object.length_m": 0.10,
        "scene.object.radius_m": 0.085,
        "scene.object.mass_kg": 1.0,
        "scene.object.friction": 0.7,
        "scene.object.grasp_offset_m": 0.13,
        "scene.object.grasp_height_m": 0.03,
        "scene.object.colour": (0.78, 0.16, 0.13, 1.0),
        "scene.object.parts": _PARTS,
        "scene.task.start_xy_m": (0.48, 0.12),
        "scene.task.start_range_m": 0.10,
        "scene.task.start_range_rad": 0.5236,
        "scene.task.goal_xy_m": (0.48, -0.15),
        "scene.task.goal_range_m": 0.03,
        "scene.task.goal_range_rad": 0.0,
        "scene.task.goal_tolerance_m": 0.03,
        "scene.task.yaw_tolerance_rad": 0.2618,
        "scene.task.clear_height_m": 0.10,
        "scene.task.lift_height_m": 0.12,
        "carry.impedance.internal_force_n": 27.0,
        "carry.impedance.stiffness_n_per_m": 800.0,
        "safety": 3.0,
    },
)


def pot_lift(config: Config) -> Task:
    """Return the task."""
    instruction = "Lift the pot by both handles and put it on the green mark."
    return carry_task("pot_lift", instruction, preset(config, _VALUES), "pot-trial")
