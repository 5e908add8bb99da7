"""Tables of objects and motions of a carry (docs/carry.md).

A row is configuration defaults {dotted path: value}. An object's row may state its `safety`, that
of the pinch against slipping. Other distributions add rows through the entry point groups
`minidual.objects` and `minidual.motions`.

Parallel grippers hold the objects from above: 80 mm opening, pads 3 mm over the axis.
"""

from collections.abc import Mapping
from typing import Any

from minidual.config.scene import ObstacleConfig
from minidual.control.gripper import SAFETY, pinch_force
from minidual.registry import Registry

type Row = Mapping[str, Any]
"""Configuration defaults {dotted path: value}; the configuration validates them."""

_BOARD: Row = {
    "scene.object.shape": "box",
    "scene.object.length_m": 0.40,
    "scene.object.width_m": 0.05,
    "scene.object.height_m": 0.03,
    "scene.object.mass_kg": 1.0,
    "scene.object.friction": 0.7,
    "scene.object.grasp_offset_m": 0.16,
    "scene.object.colour": (0.63, 0.44, 0.26, 1.0),
    "carry.impedance.internal_force_n": 27.0,
    "carry.impedance.stiffness_n_per_m": 500.0,
    # Twice the usual: with stiffer faces, pads lost contact for one step in 3 of 10 carries at
    # 30 N, in 0 of 12 at 60 N.
    "safety": 3.0,
}
_BOX: Row = {
    "scene.object.shape": "box",
    "scene.object.length_m": 0.30,
    "scene.object.width_m": 0.06,
    "scene.object.height_m": 0.06,
    "scene.object.mass_kg": 0.5,
    "scene.object.friction": 0.3,
    "scene.object.colour": (0.36, 0.55, 0.72, 1.0),
    # The hand allows 70 N continuously, 140 N at most; a carry lasts seconds.
    "scene.physics.finger_force_max_n": 110.0,
    "carry.impedance.internal_force_n": 42.0,
    "carry.impedance.stiffness_n_per_m": 400.0,
}
_GLASS: Row = {
    "scene.object.radius_m": 0.01,
    "scene.object.mass_kg": 0.15,
    "scene.object.friction": 0.4,
    "scene.object.break_force_n": 20.0,
    "scene.object.break_pinch_n": 40.0,
    "scene.object.colour": (0.62, 0.84, 0.86, 0.55),
    "scene.task.internal_force_min_n": 10.0,
    "carry.impedance.internal_force_n": 13.0,
    "carry.impedance.stiffness_n_per_m": 200.0,
    "carry.impedance.force_correction_max_n": 3.0,
    # Slow landing: with low stiffness the tracking error of a fast one becomes an impact.
    "carry.pace.object_acceleration_m_per_s2": 0.9,
    "carry.pace.landing_m": 0.003,
    "carry.pace.landing_s": 0.35,
}
OBJECTS: Registry[Row] = Registry(
    "object",
    {"rod": {}, "board": _BOARD, "box": _BOX, "glass": _GLASS},
    group="minidual.objects",
)

_ROTATE: Row = {
    # Clockwise, so that the arms do not cross. With the goal 10 cm farther right the left arm is
    # almost stretched: its smallest singular value falls from 0.11 to 0.02.
    "scene.task.goal_xy_m": (0.5, -0.15),
    "scene.task.goal_yaw_rad": -1.570796,
    # Largest range that all objects allow: within 3 cm 2 of 20 boards are not lifted, 5 degrees
    # more stretch the arm.
    "scene.task.goal_range_m": 0.02,
    "scene.task.goal_range_rad": 0.0,
}
_OVER: Row = {
    "scene.task.obstacle": ObstacleConfig(),
    "scene.task.lift_height_m": 0.17,
}
MOTIONS: Registry[Row] = Registry(
    "motion",
    {"straight": {}, "rotate": _ROTATE, "over": _OVER},
    group="minidual.motions",
)


def with_pinch(row: Row) -> dict[str, Any]:
    """Return a row without `safety` and with the pinch that its squeeze needs, if it states both.

    A pinch that the row states stays.
    """
    values = {"safety": SAFETY, **row}
    safety = values.pop("safety")
    squeeze_n = row.get("carry.impedance.internal_force_n")
    friction = row.get("scene.object.friction")
    mass_kg = row.get("scene.object.mass_kg")
    if squeeze_n is not None and friction is not None and mass_kg is not None:
        pinch_n = pinch_force(squeeze_n, friction, mass_kg, safety=safety)
        values.setdefault("carry.impedance.pinch_n", round(pinch_n, 1))
    return values
