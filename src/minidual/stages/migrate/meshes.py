"""Row 7: whether the collision shapes of each link cover its visual shapes."""

import itertools

import mujoco
import numpy as np

from minidual.config.scene import SceneConfig
from minidual.plant.contact import GROUP_COLLISION, GROUP_VISUAL
from minidual.plant.model import build_model
from minidual.robot.pair import Array, Robot

_COVER = 0.8
_CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


def small_meshes(robot: Robot, model: mujoco.MjModel | None = None) -> list[str]:
    """Return the links whose collision shapes are shorter than 80 % of their visual shapes.

    Args:
        robot: The arms.
        model: With visual geoms; by default the robot's own.
    """
    shown: mujoco.MjModel = model or build_model(SceneConfig(), robot, visuals=True)
    small: list[str] = []
    for body in range(shown.nbody):
        name = shown.body(body).name
        if not name.startswith(tuple(f"{side}_" for side in robot.sides)):
            continue
        drawn = _extent(shown, body, GROUP_VISUAL)
        collides = _extent(shown, body, GROUP_COLLISION)
        if drawn is None or collides is None:
            continue
        if float(collides.max()) < _COVER * float(drawn.max()):
            small.append(name)
    return small


def _extent(model: mujoco.MjModel, body: int, group: int) -> Array | None:
    """Return the size (3,) [m] of a body's geoms of one group, or None if it has none."""
    points: list[Array] = []
    for geom in np.flatnonzero(model.geom_bodyid == body):
        if model.geom_group[geom] != group:
            continue
        centre = model.geom_aabb[geom, :3]
        half = model.geom_aabb[geom, 3:]
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        corners = centre + _CORNERS * half
        points.append(model.geom_pos[geom] + corners @ rotation.reshape(3, 3).T)
    if not points:
        return None
    everything = np.concatenate(points)
    return everything.max(axis=0) - everything.min(axis=0)
