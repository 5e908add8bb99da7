"""How the object travels: one explicit table of motions, each with its goal and what stands in the way."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from minidual.config.root import Config
from minidual.config.scene import ObstacleConfig
from minidual.errors import unknown_name
from minidual.tasks.objects import filled, replaced, with_object


@dataclass(frozen=True)
class CarryMotion:
    """One row of the table.

    Attributes:
        name: As typed.
        summary: One line for people.
        task: Values of `scene.task`.
    """

    name: str
    summary: str
    task: Mapping[str, Any] = field(default_factory=dict)


MOTIONS: dict[str, CarryMotion] = {
    row.name: row
    for row in (
        CarryMotion("straight", "50 cm from the left of the table to the right"),
        CarryMotion(
            "rotate",
            "40 cm, and turned by 90 degrees in the plane on the way",
            # Turned clockwise, the left hand ends farther from the bases and the arms do not cross. Ten centimetres
            # farther to the right the left arm would be stretched: its smallest singular value falls from 0.11 to 0.02.
            {"goal_xy_m": (0.5, -0.15), "goal_yaw_rad": -round(math.pi / 2, 6), "yaw_tolerance_rad": 0.08727},
        ),
        CarryMotion(
            "over",
            "50 cm, lifted over a block of 10 cm that stands in the way",
            {"obstacle": ObstacleConfig(), "lift_height_m": 0.17},
        ),
    )
}


def motion_spec(name: str) -> CarryMotion:
    """Return the row of a motion, or say which exist."""
    if name not in MOTIONS:
        raise unknown_name("motion", name, MOTIONS)
    return MOTIONS[name]


def with_motion(config: Config) -> Config:
    """Return the configuration for the motion that `carry.motion` names; what somebody has set stays as it was set."""
    spec = motion_spec(config.carry.motion)
    task = filled(config.scene.task, **spec.task)
    return replaced(config, scene=replaced(config.scene, task=task))


def carry_config(config: Config) -> Config:
    """Return the configuration under which the named object is carried along the named motion.

    Call it once, on the configuration as loaded; called again it changes nothing.

    Raises:
        UsageError: There is no such object or motion.
    """
    return with_motion(with_object(config))
