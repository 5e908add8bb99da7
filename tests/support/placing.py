"""Put objects where a test wants them."""

from __future__ import annotations

import mujoco

from minidual.plant.bodies import ObjectPose
from minidual.plant.world import World


def put_at(world: World, name: str | None, pose: ObjectPose) -> None:
    """Put an object at a pose, at rest."""
    item = world.truth(name)
    item.put(pose)
    item.qvel[:] = 0.0
    mujoco.mj_forward(world.model, world.data)
