"""A task's objects and obstacles as the planner's shapes."""

import math

import numpy as np

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import IDENTITY, Box, Cylinder, Mesh
from minidual.config.scene import OBSTACLE, ObjectConfig, PartConfig, SceneConfig
from minidual.robot.pair import Array, Robot
from minidual.skills.states import Thing

_ALONG_Y = (0.5**0.5, -(0.5**0.5), 0.0, 0.0)
_PRISM = 16
"""Sides of the prism round a cylinder."""


def thing_of(body: ObjectConfig) -> Thing:
    """Return an object as the planner's: one shape, or the hulls of its parts."""
    part, *others = body.solids
    if others:
        pieces = tuple(_corners(part).tobytes() for part in body.solids)
        return Thing(Mesh(body.name, (0.0, 0.0, 0.0), pieces=pieces), upright=body.upright)
    return Thing(shape_of(body.name, part), upright=body.upright)


def shape_of(name: str, part: PartConfig) -> Box | Cylinder:
    """Return a part as the planner's shape."""
    if part.shape == "box":
        return Box(name, part.position_m, size_m=part.size_m)
    x, y, z = part.size_m
    if part.axis == "z":
        return Cylinder(name, part.position_m, IDENTITY, x / 2, z)
    return Cylinder(name, part.position_m, _ALONG_Y, x / 2, y)


def _corners(part: PartConfig) -> Array:
    """Return the corners (k, 3) [m] of a part, a cylinder as a prism round it."""
    if part.shape == "box":
        ring = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
    else:
        angles = np.arange(_PRISM) * math.tau / _PRISM
        ring = np.c_[np.cos(angles), np.sin(angles)] / math.cos(math.pi / _PRISM)
    axis = "xyz".index(part.axis)
    ends = [np.insert(ring, axis, end, axis=1) for end in (-1.0, 1.0)]
    return np.vstack(ends) * part.half_m + part.position_m


def around(scene: SceneConfig, robot: Robot) -> PlanningScene:
    """Return the scene without the objects that are handled."""
    room = PlanningScene(robot=robot)
    block = scene.task.obstacle
    if block is None:
        return room
    centre_m = (*block.xy_m, block.size_m[2] / 2)
    return room.with_obstacles(Box(OBSTACLE, centre_m, size_m=block.size_m))
