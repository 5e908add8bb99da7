"""Table, marks, obstacle and objects in the MuJoCo model."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from minidual.config.scene import OBSTACLE, ObjectConfig, SceneConfig
from minidual.robot.pair import Robot

GROUP_VISUAL, GROUP_MARKER = 1, 2
# Stiff contacts with little creep; docs/simulation.md compares cone and impratio.
SOLREF = [0.002, 1.0]
SOLIMP = [0.99, 0.999, 0.001, 0.5, 2.0]
_FACE_MARGIN_M = 0.0002
"""Contact distance of flat faces, which enlarges boxes. Without it parallel faces lose contact for single steps and the
fingers jump."""
_BAND_M = 0.0006
_TABLE_HALF_M = (0.6, 0.8, 0.02)
_TABLE_CENTRE_X_M = 0.38
_BLUE = [0.10, 0.25, 0.75, 1.0]
_ALONG_Y = [np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0]


def add_surroundings(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    """Add everything but arms and objects."""
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.93, 0.95, 0.98],
        rgb2=[0.62, 0.70, 0.80],
        width=64,
        height=384,
    )
    world = spec.worldbody
    world.add_light(
        name="key",
        pos=[0.9, 0.7, 2.0],
        dir=[-0.35, -0.4, -1.0],
        castshadow=True,
        diffuse=[0.55, 0.55, 0.53],
        specular=[0.2, 0.2, 0.2],
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    )
    world.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[4, 4, 0.1],
        pos=[0, 0, -0.75],
        rgba=[0.80, 0.82, 0.85, 1],
        contype=0,
        conaffinity=0,
    )
    table = world.add_body(name="table", pos=[_TABLE_CENTRE_X_M, 0.0, -_TABLE_HALF_M[2]])
    table.add_geom(
        name="table_top",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=list(_TABLE_HALF_M),
        rgba=[0.42, 0.47, 0.50, 1],
        friction=[scene.object.friction, 0.005, 0.0001],
        solref=SOLREF,
        solimp=SOLIMP,
    )
    for x in (-1, 1):
        for y in (-1, 1):
            table.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                size=[0.03, 0.355, 0],
                rgba=[0.25, 0.27, 0.3, 1],
                pos=[x * (_TABLE_HALF_M[0] - 0.06), y * (_TABLE_HALF_M[1] - 0.06), -0.375],
                contype=0,
                conaffinity=0,
            )
    for arm in robot.sides:
        spec.add_exclude(bodyname1="table", bodyname2=f"{arm}_{robot.arm.base_link}")  # the bases stand on it
    half_x, half_y, _ = scene.object.half_sizes_m
    for label, xy, yaw, rgba in (
        ("start", scene.task.start_xy_m, 0.0, [0.85, 0.87, 0.9, 1.0]),
        ("goal", scene.task.goal_xy_m, scene.task.goal_yaw_rad, [0.15, 0.62, 0.35, 1.0]),
    ):
        world.add_geom(
            name=f"{label}_mark",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[xy[0], xy[1], 0.0003],
            rgba=rgba,
            size=[1.6 * half_x, half_y + 0.01, 0.0003],
            contype=0,
            conaffinity=0,
            group=GROUP_MARKER,
            quat=_about_z(yaw),
        )
    obstacle = scene.task.obstacle
    if obstacle is not None:
        x, y, z = obstacle.size_m
        world.add_geom(
            name=OBSTACLE,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[x / 2, y / 2, z / 2],
            rgba=[0.75, 0.22, 0.2, 1.0],
            pos=[*obstacle.xy_m, z / 2],
        )


def _about_z(yaw_rad: float) -> list[float]:
    return [float(np.cos(yaw_rad / 2.0)), 0.0, 0.0, float(np.sin(yaw_rad / 2.0))]


def add_objects(spec: mujoco.MjSpec, scene: SceneConfig) -> None:
    """Add the objects as free bodies, frames at the centre of mass."""
    for item in scene.objects.values():
        _add_object(spec, item, scene.task.start_xy_m if item.xy_m is None else item.xy_m)


def _add_object(spec: mujoco.MjSpec, item: ObjectConfig, xy_m: tuple[float, float]) -> None:
    body = spec.worldbody.add_body(name=item.name, pos=[*xy_m, item.rest_height_m])
    body.add_freejoint(name=f"{item.name}_free")
    half_x, half_y, half_z = item.half_sizes_m
    half_long = item.length_m / 2
    shape: dict[str, Any]
    if item.shape == "cylinder":
        shape = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER} | ({} if item.upright else {"quat": _ALONG_Y})
        condim = 6  # rolling friction: without it a cylinder rolls away by itself
        margin = 0.0
        size, band = [item.radius_m, half_long, 0], [item.radius_m + _BAND_M, 0.015, 0]
    else:
        shape = {"type": mujoco.mjtGeom.mjGEOM_BOX}
        condim = 4  # faces do not roll; rolling friction at many contact points over-constrains them
        margin = _FACE_MARGIN_M
        size = [half_x, half_y, half_z]
        band = [half_x + _BAND_M, half_y + _BAND_M, half_z + _BAND_M]
        band[2 if item.upright else 1] = 0.015
    body.add_geom(
        name=item.name,
        size=size,
        mass=item.mass_kg,
        rgba=list(item.colour),
        condim=condim,
        friction=[item.friction, 0.01, item.rolling_friction],
        solref=SOLREF,
        solimp=SOLIMP,
        margin=margin,
        **shape,
    )
    # Bands mark the grasps and make the ends visible to the camera.
    for offset in (-item.grasp_offset_m, item.grasp_offset_m):
        body.add_geom(
            size=band,
            pos=[0, 0, offset] if item.upright else [0, offset, 0],
            rgba=_BLUE,
            mass=0,
            contype=0,
            conaffinity=0,
            group=GROUP_VISUAL,
            **shape,
        )
