"""Table, marks, obstacle and objects in the MuJoCo model."""

import itertools
from typing import Any

import mujoco
import numpy as np

from minidual.config.scene import DISTRACTOR_HALF_M, DISTRACTORS, OBSTACLE, MarkConfig, PartConfig, SceneConfig
from minidual.registry import rows_beside
from minidual.robot.pair import Array, Robot

_LOOK = rows_beside(__file__)
GROUP_VISUAL, GROUP_MARKER, GOAL_MARK = 1, 2, "goal_mark"
# Stiff contacts with little creep; docs/simulation.md compares cone and impratio.
SOLREF = [0.002, 1.0]
SOLIMP = [0.99, 0.999, 0.001, 0.5, 2.0]
# Contact distance of flat faces. Without it parallel faces lose contact for single steps and the fingers jump.
_FACE_MARGIN_M = 0.0002
_BAND_M = 0.0006
_TABLE_HALF_M = (0.6, 0.8, 0.02)
_TABLE_CENTRE_X_M = 0.38
_BOX, _CYLINDER = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
INTANGIBLE: dict[str, int] = {"contype": 0, "conaffinity": 0}
_BLUE = [0.10, 0.25, 0.75, 1.0]
_ALONG_Y = [np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0]


def add_surroundings(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    """Set the look; add everything but arms and objects."""
    for section, values in _LOOK["visual"].items():
        for name, value in values.items():
            setattr(getattr(spec.visual, section), name, value)
    world, gradient = spec.worldbody, mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    spec.add_texture(type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=gradient, **_LOOK["sky"])
    world.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, **_LOOK["light"])
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, **_LOOK["floor"], **INTANGIBLE)
    table = world.add_body(name="table", pos=[_TABLE_CENTRE_X_M, 0.0, -_TABLE_HALF_M[2]])
    top = table.add_geom(name="table_top", type=_BOX, size=list(_TABLE_HALF_M), rgba=[0.42, 0.47, 0.50, 1])
    top.friction, top.solref, top.solimp = [scene.object.friction, 0.005, 0.0001], SOLREF, SOLIMP
    for x, y in itertools.product((-1, 1), repeat=2):
        pos = [x * (_TABLE_HALF_M[0] - 0.06), y * (_TABLE_HALF_M[1] - 0.06), -0.375]
        table.add_geom(type=_CYLINDER, size=[0.03, 0.355, 0], rgba=[0.25, 0.27, 0.3, 1], pos=pos, **INTANGIBLE)
    for arm in robot.sides:
        spec.add_exclude(bodyname1="table", bodyname2=f"{arm}_{robot.arm.base_link}")  # the bases stand on it
    for layer, mark in enumerate(marks(scene)):
        rgba, place = list(mark.colour), [*mark.xy_m, 0.0003 * (1 + (layer if scene.marks else 0))]
        geom = world.add_geom(name=mark.name, type=_BOX, pos=place, rgba=rgba, group=GROUP_MARKER, **INTANGIBLE)
        half_x, half_y = mark.size_m[0] / 2, mark.size_m[1] / 2
        geom.size = [half_x, half_y, 0.0003]
        geom.quat = [np.cos(mark.yaw_rad / 2.0), 0.0, 0.0, np.sin(mark.yaw_rad / 2.0)]
        if mark.round:
            geom.type, geom.size = _CYLINDER, [half_x, 0.0003, 0.0]
    asked = scene.task
    for name, kind in zip(DISTRACTORS, (_BOX, _CYLINDER), strict=True):
        size = [DISTRACTOR_HALF_M] * 3
        world.add_geom(name=name, type=kind, size=size, pos=[_TABLE_CENTRE_X_M, 0, -0.3], rgba=[0] * 4, **INTANGIBLE)
    if asked.obstacle is not None:
        size, xy = np.array(asked.obstacle.size_m) / 2, asked.obstacle.xy_m
        world.add_geom(name=OBSTACLE, type=_BOX, size=size, rgba=[0.75, 0.22, 0.2, 1.0], pos=[*xy, size[2]])


def marks(scene: SceneConfig) -> tuple[MarkConfig, ...]:
    """Return the scene's marks, by default those of start and goal."""
    if scene.marks:
        return scene.marks
    asked, part = scene.task, scene.object.solids[0]
    size = 3.2 * part.half_m[0], 2.0 * part.half_m[1] + 0.02
    plate = part.shape == "cylinder" and part.axis == "z"
    start, goal = asked.start_xy_m, asked.goal_xy_m
    pale, green = (0.85, 0.87, 0.9, 1.0), (0.15, 0.62, 0.35, 1.0)
    return (
        MarkConfig(name="start_mark", xy_m=start, size_m=size, round=plate, colour=pale),
        MarkConfig(name=GOAL_MARK, xy_m=goal, size_m=size, yaw_rad=asked.goal_yaw_rad, round=plate, colour=green),
    )


def add_objects(spec: mujoco.MjSpec, scene: SceneConfig) -> None:
    """Add the objects as free bodies, frames at the centre of mass."""
    for item in scene.objects.values():
        xy_m = scene.task.start_xy_m if item.xy_m is None else item.xy_m
        body = spec.worldbody.add_body(name=item.name, pos=[*xy_m, item.rest_height_m])
        body.add_freejoint(name=f"{item.name}_free")
        for index, part in enumerate(item.solids):
            half = np.array(part.half_m)
            shape, size = _geom(part, half)
            # Rolling friction: without it a cylinder rolls away by itself. Faces do not roll; rolling friction at many
            # contact points over-constrains them.
            condim, margin = (6, 0.0) if part.shape == "cylinder" else (4, _FACE_MARGIN_M)
            name, mass = (f"{item.name}_part{index}", 0.0) if index else (item.name, item.mass_kg)
            geom = body.add_geom(name=name, size=size, mass=mass, rgba=part.colour, pos=part.position_m, **shape)
            geom.condim, geom.margin, geom.solref, geom.solimp = condim, margin, SOLREF, SOLIMP
            geom.friction = [item.friction, 0.01, item.rolling_friction]
        if item.parts:
            continue
        # Bands mark the grasps and make the ends visible to the camera.
        (part,), long = item.solids, 2 if item.upright else 1
        half = np.array(part.half_m) + _BAND_M
        half[long] = 0.015
        shape, size = _geom(part, half)
        for offset in (-item.grasp_offset_m, item.grasp_offset_m) if item.grasp_offset_m else ():
            pos = [0.0, 0.0, offset] if item.upright else [0.0, offset, 0.0]
            body.add_geom(size=size, pos=pos, rgba=_BLUE, mass=0, group=GROUP_VISUAL, **shape, **INTANGIBLE)


def _geom(part: PartConfig, half: Array) -> tuple[dict[str, Any], list[float]]:
    if part.shape == "box":
        return {"type": _BOX}, half.tolist()
    if part.axis == "z":
        return {"type": _CYLINDER}, [half[0], half[2], 0.0]
    return {"type": _CYLINDER, "quat": _ALONG_Y}, [half[0], half[1], 0.0]
