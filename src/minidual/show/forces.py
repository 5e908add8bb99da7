"""Forces of the hands, as films and the view draw them."""

import numpy as np

from minidual.plant.simulation import Simulation
from minidual.show.view.overlay import ARM_RGB, Arrow

_OFFSET_M = np.array([0.05, 0.0, 0.0])
"""Of force arrows from the hands, where the object would hide them."""


def force_arrows(world: Simulation) -> tuple[Arrow, ...]:
    """Return the force of each hand on all objects, at the hand."""
    forces = np.sum([world.truth(name).forces() for name in world.objects], axis=0)
    return tuple(
        Arrow(world.data.body(hand).xpos + _OFFSET_M, np.array(force), rgb)
        for hand, force, rgb in zip(world.robot.tcp_names, forces, ARM_RGB, strict=True)
    )
