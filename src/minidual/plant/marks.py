"""Marks on the table: fiducials, and those of the task's start and goal."""

import mujoco
import numpy as np

from minidual.config.scene import MarkConfig, SceneConfig
from minidual.plant.contact import GROUP_MARKER, INTANGIBLE

GOAL_MARK = "goal_mark"

_PALE = (0.85, 0.87, 0.9, 1.0)
_GREEN = (0.15, 0.62, 0.35, 1.0)
_MARK_HALF_HEIGHT_M = 0.0003

_FIDUCIALS_XY_M = ((0.5, 0.0), (0.64, 0.26), (0.64, -0.26))
"""Black squares on white: a picture of any table shows where its camera stands."""
_FIDUCIAL_LAYERS = (
    ([0.03, 0.03, 0.0002], [0.95, 0.95, 0.95, 1.0]),
    ([0.018, 0.018, 0.0004], [0.04, 0.04, 0.04, 1.0]),
)
"""Half size (3,) [m] and rgba."""


def goal_mark(model: mujoco.MjModel) -> int | None:
    """Return the index of the geom that marks a trial's goal; None if the scene has marks of its own."""
    geom = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, GOAL_MARK)
    return None if geom < 0 else geom


def marks(scene: SceneConfig) -> tuple[MarkConfig, ...]:
    """Return the scene's marks, by default those of start and goal."""
    if scene.marks:
        return scene.marks
    part = scene.object.solids[0]
    size_m = (3.2 * part.half_m[0], 2.0 * part.half_m[1] + 0.02)
    is_disk = part.shape == "cylinder" and part.axis == "z"
    start = MarkConfig(
        name="start_mark",
        xy_m=scene.task.start_xy_m,
        size_m=size_m,
        round=is_disk,
        colour=_PALE,
    )
    goal = MarkConfig(
        name=GOAL_MARK,
        xy_m=scene.task.goal_xy_m,
        size_m=size_m,
        yaw_rad=scene.task.goal_yaw_rad,
        round=is_disk,
        colour=_GREEN,
    )
    return start, goal


def add_marks(spec: mujoco.MjSpec, scene: SceneConfig) -> None:
    """Add fiducials and marks, without contacts; the scene's own marks lie above one another."""
    for x, y in _FIDUCIALS_XY_M:
        for size, rgba in _FIDUCIAL_LAYERS:
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                group=GROUP_MARKER,
                pos=[x, y, 0.0],
                size=size,
                rgba=rgba,
                **INTANGIBLE,
            )
    for layer, mark in enumerate(marks(scene)):
        layers_below = layer if scene.marks else 0
        _add_mark(spec, mark, 0.0003 * (1 + layers_below))


def _add_mark(spec: mujoco.MjSpec, mark: MarkConfig, height_m: float) -> None:
    geom = spec.worldbody.add_geom(
        name=mark.name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[*mark.xy_m, height_m],
        rgba=list(mark.colour),
        group=GROUP_MARKER,
        **INTANGIBLE,
    )
    half_x = mark.size_m[0] / 2
    half_y = mark.size_m[1] / 2
    geom.size = [half_x, half_y, _MARK_HALF_HEIGHT_M]
    geom.quat = [np.cos(mark.yaw_rad / 2.0), 0.0, 0.0, np.sin(mark.yaw_rad / 2.0)]
    if mark.round:
        geom.type = mujoco.mjtGeom.mjGEOM_CYLINDER
        geom.size = [half_x, _MARK_HALF_HEIGHT_M, 0.0]
