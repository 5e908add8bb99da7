"""Show any plant: the world behind it, or its measured arms alone."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

from minidual.config.scene import SceneConfig
from minidual.plant.lifecycle import Connection
from minidual.plant.protocol import Plant
from minidual.plant.world import World
from minidual.robot.pair import Robot
from minidual.show.view import View
from minidual.show.watch import Narrator, watched

_OUT_OF_SIGHT_M = -10.0
"""Height of objects that nothing measures."""


@contextmanager
def watched_plant(
    view: View | None,
    link: Connection,
    scene: SceneConfig,
    narrate: Narrator,
) -> Iterator[Callable[[], None]]:
    """Show a plant inside the block; yield what draws it once.

    Hardware has no world: its measured arms are drawn, without objects. A world behind the plant is
    also drawn after each of its steps.
    """
    if view is None:
        yield lambda: None
        return
    twin = link.twin()
    world = _arms_alone(scene, link.plant.robot) if twin is None else twin.world

    def draw() -> None:
        if twin is None:
            _take_over(world, link.plant)
        if world.observer is not None:
            world.observer(world)

    with watched(view, world, narrate):
        yield draw


def _arms_alone(scene: SceneConfig, robot: Robot) -> World:
    """Return a world to draw, its objects out of sight."""
    world = World(scene, robot)
    for name in world.objects:
        world.truth(name).qpos[2] = _OUT_OF_SIGHT_M
    return world


def _take_over(world: World, plant: Plant) -> None:
    """Put the arms and fingers of a world where a plant measures them."""
    data = world.data
    data.time = plant.time
    data.qpos[world.joints.qpos] = plant.q
    data.qpos[world.finger_joints.qpos] = np.repeat(plant.fingers, 2)
    mujoco.mj_forward(world.model, data)
