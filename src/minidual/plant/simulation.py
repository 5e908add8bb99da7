"""A simulated scene to draw, log or disturb: the plant's own, or a copy of it."""

from collections.abc import Callable
from typing import Any, Protocol

import mujoco

from minidual.config.scene import SceneConfig
from minidual.plant.bodies import NamedObject
from minidual.robot.pair import Robot


class Simulation(Protocol):
    """A simulated scene.

    Attributes:
        scene: As configured.
        robot: The arms.
        model, data: MuJoCo's.
        objects: Names of the objects.
        observer: Called after each step, or None.
    """

    scene: SceneConfig
    robot: Robot
    model: mujoco.MjModel
    data: mujoco.MjData
    objects: tuple[str, ...]
    observer: Callable[[Any], None] | None

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        ...

    def truth(self, name: str | None = None) -> NamedObject:
        """Return an object, None for the only one."""
        ...
