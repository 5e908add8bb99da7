"""Table of carry motions: goal and obstacle."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from minidual.config.scene import ObstacleConfig
from minidual.registry import Registry


@dataclass(frozen=True)
class CarryMotion:
    """One motion; `values` are configuration defaults {dotted path: value}."""

    summary: str
    values: Mapping[str, Any] = field(default_factory=dict)


MOTIONS: Registry[CarryMotion] = Registry(
    "motion",
    {
        "straight": CarryMotion("50 cm from the left of the table to the right"),
        # Clockwise, so that the arms do not cross. With the goal 10 cm farther right the left arm is almost stretched:
        # its smallest singular value falls from 0.11 to 0.02.
        "rotate": CarryMotion(
            "40 cm, and turned by 90 degrees in the plane on the way",
            {
                "scene.task.goal_xy_m": (0.5, -0.15),
                "scene.task.goal_yaw_rad": -round(math.pi / 2, 6),
                "scene.task.yaw_tolerance_rad": 0.08727,
            },
        ),
        "over": CarryMotion(
            "50 cm, lifted over a block of 10 cm that stands in the way",
            {"scene.task.obstacle": ObstacleConfig(), "scene.task.lift_height_m": 0.17},
        ),
    },
    group="minidual.motions",
)
