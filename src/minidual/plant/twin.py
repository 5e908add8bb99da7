"""The simulated world behind a plant: for the judge, for pictures, and to put objects down.

A method never gets it. A plant without one is hardware: nothing measures the objects there.
"""

from collections.abc import Mapping
from typing import Protocol

import mujoco
import numpy as np

from minidual.plant.bodies import ObjectPose
from minidual.plant.world import World
from minidual.robot.pair import Array

MIRRORED = (
    mujoco.mjtState.mjSTATE_FULLPHYSICS
    | mujoco.mjtState.mjSTATE_CTRL
    | mujoco.mjtState.mjSTATE_WARMSTART
)
"""Parts of the state that a copy of a world needs; contact forces follow from them."""


class Twin(Protocol):
    """A simulated world that stands behind a plant, or a copy of it.

    Attributes:
        world: As it was at the last control step.
    """

    world: World

    def place(self, poses: Mapping[str, ObjectPose]) -> None:
        """Put objects at rest at poses; the arms stay.

        Raises:
            UsageError: An object is unknown, or held.
        """
        ...


class OwnWorld:
    """The world of a plant that is simulated in this process."""

    def __init__(self, world: World) -> None:
        self.world = world

    def place(self, poses: Mapping[str, ObjectPose]) -> None:
        """See `Twin`."""
        put_down(self.world, poses)


def put_down(world: World, poses: Mapping[str, ObjectPose]) -> None:
    """Put objects at rest at poses; the arms stay."""
    new_poses = {world.truth(name): pose for name, pose in poses.items()}
    for named_object, pose in new_poses.items():
        named_object.put(pose)
        named_object.qvel[:] = 0.0
    mujoco.mj_forward(world.model, world.data)


def state_of(world: World) -> Array:
    """Return the state (k,) that `mirror` takes over."""
    state = np.empty(state_size(world))
    mujoco.mj_getState(world.model, world.data, state, MIRRORED)
    return state


def mirror(world: World, state: Array) -> None:
    """Take over the state (k,) of another world of the same scene, with its contacts."""
    mujoco.mj_setState(world.model, world.data, state, MIRRORED)
    mujoco.mj_forward(world.model, world.data)
    if world.observer is not None:
        world.observer(world)


def state_size(world: World) -> int:
    """Return the length of the state."""
    return int(mujoco.mj_stateSize(world.model, MIRRORED))
