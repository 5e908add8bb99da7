"""Render docs/scene.jpg: both arms hold the object above the table, halfway along the carry."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from minidual.config.scene import SceneConfig
from minidual.motion.ik import ArmIK
from minidual.plant.render import Camera
from minidual.plant.world import World
from minidual.tasks.rod_carry import grasp_offsets, level_pose

_SIZE_PX = (1264, 711)
_FRAME_PX = (120, 30, 1080, 570)  # left, upper, right, lower: the part of the picture with something in it


def render(path: Path) -> None:
    """Write the picture as a JPEG to `path`."""
    from PIL import Image

    scene = SceneConfig()
    world = World(scene, visuals=True)
    T_world_object = level_pose(0.5, 0.06, 0.20, 0.12)
    hands = [
        ArmIK(side).solve(T_world_object @ T_object_tcp, np.array(world.robot.arm.home)).q
        for side, T_object_tcp in zip(world.robot.sides, grasp_offsets(scene), strict=True)
    ]
    world.reset(np.concatenate(hands))
    world.data.qpos[world.finger_joints.qpos] = scene.object.radius_m
    world.place(None, T_world_object)
    buffer = world.model.vis.global_  # room for twice the size in each direction
    buffer.offwidth, buffer.offheight = 2 * _SIZE_PX[0], 2 * _SIZE_PX[1]
    with Camera(world.model, *_SIZE_PX, shadows=True, supersample=2) as camera:
        picture = camera.picture(world.data, "overview")
    trimmed = Image.fromarray(picture).crop(_FRAME_PX)
    trimmed.save(path, quality=86, optimize=True, progressive=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("path", type=Path, nargs="?", default=Path("docs/scene.jpg"))
    arguments = parser.parse_args()
    render(arguments.path)
    print(arguments.path)
