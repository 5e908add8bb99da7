"""How the object travels: each row a motion with its goal and what stands in the way."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from minidual.config.scene import ObstacleConfig
from minidual.registry import Registry


@dataclass(frozen=True)
class CarryMotion:
    """One motion.

    Attributes:
        summary: One line for people.
        values: Configuration values {dotted path: value} that it stands for, where nobody sets others.
    """

    summary: str
    values: Mapping[str, Any] = field(default_factory=dict)


MOTIONS: Registry[CarryMotion] = Registry(
    "motion",
    {
        "straight": CarryMotion("50 cm from the left of the table to the right"),
        # Turned clockwise, the left hand ends farther from the bases and the arms do not cross. Ten centimetres farther
        # right the left arm would be stretched: its smallest singular value falls from 0.11 to 0.02.
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
