"""Everything but arms, objects and cameras: look, floor, table, distractors, obstacle."""

import itertools

import mujoco
import numpy as np

from minidual.config.scene import (
    DISTRACTOR_HALF_M,
    DISTRACTORS,
    OBSTACLE,
    ObstacleConfig,
    SceneConfig,
)
from minidual.plant.contact import INTANGIBLE, SOLIMP, SOLREF
from minidual.plant.marks import add_marks
from minidual.robot.pair import Robot

_TABLE_HALF_M = (0.6, 0.8, 0.02)
_TABLE_CENTRE_X_M = 0.38
_LEG_INSET_M = 0.06
TABLE_RGBA = (0.42, 0.47, 0.50, 1.0)
_BOX = mujoco.mjtGeom.mjGEOM_BOX
_CYLINDER = mujoco.mjtGeom.mjGEOM_CYLINDER


def add_surroundings(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    """Set the look; add everything but arms, objects and cameras."""
    _set_look(spec)
    _add_table(spec, scene, robot)
    add_marks(spec, scene)
    _add_distractors(spec)
    if scene.task.obstacle is not None:
        _add_obstacle(spec, scene.task.obstacle)


def _set_look(spec: mujoco.MjSpec) -> None:
    """Set sky, light and floor, and the quality of pictures."""
    visual = spec.visual
    visual.global_.offwidth = 1920
    visual.global_.offheight = 1080
    visual.headlight.ambient = [0.35, 0.35, 0.36]
    visual.headlight.diffuse = [0.35, 0.35, 0.35]
    visual.headlight.specular = [0.1, 0.1, 0.1]
    # Only films have shadows. MuJoCo's reach of 1 leaves speckles on the floor.
    visual.map.shadowclip = 2.0
    visual.map.znear = 0.02
    visual.quality.shadowsize = 2048
    # Software rendering: multi-sampling costs more than pixels.
    visual.quality.offsamples = 0
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.93, 0.95, 0.98],
        rgb2=[0.62, 0.70, 0.80],
        width=64,
        height=384,
    )
    spec.worldbody.add_light(
        name="key",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[0.9, 0.7, 2.0],
        dir=[-0.35, -0.4, -1.0],
        castshadow=True,
        diffuse=[0.55, 0.55, 0.53],
        specular=[0.2, 0.2, 0.2],
    )
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[4.0, 4.0, 0.1],
        pos=[0.0, 0.0, -0.75],
        rgba=[0.80, 0.82, 0.85, 1.0],
        **INTANGIBLE,
    )


def _add_table(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    """Add the table, whose top is at z = 0; the arms' bases stand on it."""
    table = spec.worldbody.add_body(name="table", pos=[_TABLE_CENTRE_X_M, 0.0, -_TABLE_HALF_M[2]])
    top = table.add_geom(
        name="table_top",
        type=_BOX,
        size=list(_TABLE_HALF_M),
        rgba=list(TABLE_RGBA),
    )
    top.friction = [scene.object.friction, 0.005, 0.0001]
    top.solref = SOLREF
    top.solimp = SOLIMP
    leg_x_m = _TABLE_HALF_M[0] - _LEG_INSET_M
    leg_y_m = _TABLE_HALF_M[1] - _LEG_INSET_M
    for x, y in itertools.product((-1, 1), repeat=2):
        table.add_geom(
            type=_CYLINDER,
            size=[0.03, 0.355, 0],
            rgba=[0.25, 0.27, 0.3, 1],
            pos=[x * leg_x_m, y * leg_y_m, -0.375],
            **INTANGIBLE,
        )
    for base in robot.base_links:
        spec.add_exclude(bodyname1="table", bodyname2=base)


def _add_distractors(spec: mujoco.MjSpec) -> None:
    """Add geoms that are under the table and invisible until a condition of trials shows them."""
    for name, kind in zip(DISTRACTORS, (_BOX, _CYLINDER), strict=True):
        spec.worldbody.add_geom(
            name=name,
            type=kind,
            size=[DISTRACTOR_HALF_M] * 3,
            pos=[_TABLE_CENTRE_X_M, 0, -0.3],
            rgba=[0] * 4,
            **INTANGIBLE,
        )


def _add_obstacle(spec: mujoco.MjSpec, obstacle: ObstacleConfig) -> None:
    half_m = np.array(obstacle.size_m) / 2
    spec.worldbody.add_geom(
        name=OBSTACLE,
        type=_BOX,
        size=half_m,
        rgba=[0.75, 0.22, 0.2, 1.0],
        pos=[*obstacle.xy_m, half_m[2]],
    )
