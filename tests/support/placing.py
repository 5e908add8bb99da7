"""Put objects where a test wants them."""

from __future__ import annotations

import mujoco

from minidual.plant.bodies import ObjectPose
from minidual.plant.world import World


def put_at(world: World, name: str | None, pose: ObjectPose) -> None:
    """Put an object at a pose, at rest."""
    found = world.truth(name)
    found.put(pose)
    found.qvel[:] = 0.0
    mujoco.mj_forward(world.model, world.data)
