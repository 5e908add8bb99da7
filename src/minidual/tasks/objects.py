"""Tables of objects and motions of a carry (docs/carry.md); a row is configuration defaults {dotted path: value}.

Parallel grippers hold the objects from above: 80 mm opening, pads 3 mm over the axis.
"""

import math
from collections.abc import Mapping
from typing import Any

from minidual.config.scene import ObstacleConfig
from minidual.control.gripper import SAFETY, pinch_force
from minidual.registry import Registry


def object_values(
    body: Mapping[str, Any], squeeze_n: float, stiffness_n_per_m: float, safety: float = SAFETY, **others: float
) -> dict[str, Any]:
    """Return configuration values; `others` belong to `carry.impedance`."""
    pinch = round(pinch_force(squeeze_n, body["friction"], body["mass_kg"], safety=safety), 1)
    gains = {"internal_force_n": squeeze_n, "stiffness_n_per_m": stiffness_n_per_m, "pinch_n": pinch, **others}
    values = {f"scene.object.{k}": v for k, v in body.items()}
    return values | {f"carry.impedance.{k}": v for k, v in gains.items()}


_BOARD: dict[str, Any] = {
    "shape": "box",
    "length_m": 0.40,
    "width_m": 0.05,
    "height_m": 0.03,
    "mass_kg": 1.0,
    "friction": 0.7,
    "grasp_offset_m": 0.16,
    "colour": (0.63, 0.44, 0.26, 1.0),
}
_BOX: dict[str, Any] = {
    "shape": "box",
    "length_m": 0.30,
    "width_m": 0.06,
    "height_m": 0.06,
    "mass_kg": 0.5,
    "friction": 0.3,
    "colour": (0.36, 0.55, 0.72, 1.0),
}
_GLASS: dict[str, Any] = {
    "radius_m": 0.01,
    "mass_kg": 0.15,
    "friction": 0.4,
    "break_force_n": 20.0,
    "break_pinch_n": 40.0,
    "colour": (0.62, 0.84, 0.86, 0.55),
}

OBJECTS: Registry[Mapping[str, Any]] = Registry(
    "object",
    {
        "rod": {},
        # Twice the usual safety: on a flat face, pads lose contact for one step in 3 of 10 carries at 30 N, in 0 of 12
        # at 60 N.
        "board": object_values(_BOARD, 27.0, 500.0, safety=3.0),
        # The hand allows 70 N continuously, 140 N at most; a carry lasts seconds.
        "box": {**object_values(_BOX, 42.0, 400.0), "scene.physics.finger_force_max_n": 110.0},
        # Slow landing: with low stiffness the tracking error of a fast one becomes an impact.
        "glass": {
            **object_values(_GLASS, 13.0, 200.0, force_correction_max_n=3.0),
            "scene.task.internal_force_min_n": 10.0,
            "carry.pace.object_acceleration_m_per_s2": 0.9,
            "carry.pace.landing_m": 0.003,
            "carry.pace.landing_s": 0.35,
        },
    },
    group="minidual.objects",
)

MOTIONS: Registry[Mapping[str, Any]] = Registry(
    "motion",
    {
        "straight": {},
        # Clockwise, so that the arms do not cross. With the goal 10 cm farther right the left arm is almost stretched:
        # its smallest singular value falls from 0.11 to 0.02.
        "rotate": {
            "scene.task.goal_xy_m": (0.5, -0.15),
            "scene.task.goal_yaw_rad": -round(math.pi / 2, 6),
            "scene.task.yaw_tolerance_rad": 0.08727,
        },
        "over": {"scene.task.obstacle": ObstacleConfig(), "scene.task.lift_height_m": 0.17},
    },
    group="minidual.motions",
)
