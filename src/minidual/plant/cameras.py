"""Cameras of the scene: where they stand, and how much they see."""

import mujoco
import numpy as np

from minidual.config.scene import SceneConfig
from minidual.plant.marks import marks
from minidual.robot.pair import Array, Robot

Position = tuple[float, float, float]

CAMERAS: tuple[str, ...] = ("high", "left", "right")
"""Recorded cameras, in storage order; `overview` is not recorded."""

_HIGH_AT: Position = (1.15, 0.0, 0.72)
_HIGH_TARGET: Position = (0.44, 0.0, 0.07)
_HIGH_FOVY_DEG = 42.0
"""Usual vertical field of view; a task with far starts or goals gets a larger one."""
_HIGH_MARGIN_DEG = 8.0
_OVERVIEW_AT: Position = (1.75, -0.95, 1.05)
_OVERVIEW_TARGET: Position = (0.28, 0.0, 0.18)
_OVERVIEW_FOVY_DEG = 40.0
_HAND_FOVY_DEG = 62.0


def add_cameras(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    """Add `high`, `overview` and one camera a hand."""
    R_high = facing(_HIGH_AT, _HIGH_TARGET)
    _add_camera(spec, "high", _HIGH_AT, R_high, _high_fovy_deg(scene, R_high))
    add_camera(spec, "overview", _OVERVIEW_AT, _OVERVIEW_TARGET, _OVERVIEW_FOVY_DEG)
    # The tilt about y, then a quarter turn about z.
    cos = np.cos(robot.hand.camera_tilt_rad / 2)
    sin = np.sin(robot.hand.camera_tilt_rad / 2)
    quat = np.sqrt(0.5) * np.array([cos, sin, sin, cos])
    for side in robot.sides:
        palm = spec.body(f"{side}_{robot.hand.palm_link}")
        palm.add_camera(
            name=side,
            pos=robot.hand.camera_position_m,
            quat=quat,
            fovy=_HAND_FOVY_DEG,
        )


def add_camera(
    spec: mujoco.MjSpec,
    name: str,
    at: Position,
    target: Position,
    fovy_deg: float,
) -> None:
    """Add an upright camera at a place [m] that faces another one."""
    _add_camera(spec, name, at, facing(at, target), fovy_deg)


def _add_camera(spec: mujoco.MjSpec, name: str, at: Position, R: Array, fovy_deg: float) -> None:
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, R.ravel())
    spec.worldbody.add_camera(name=name, pos=at, quat=quat.tolist(), fovy=fovy_deg)


def facing(position: Position, target: Position) -> Array:
    """Return the axes (3, 3) of an upright camera that faces `target`."""
    z: Array = np.subtract(position, target)
    z /= np.linalg.norm(z)
    x: Array = np.array([-z[1], z[0], 0.0])
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z], dtype=np.float64).T


def _high_fovy_deg(scene: SceneConfig, R: Array) -> float:
    """Return a vertical field of view that contains all starts, goals and objects."""
    reach_m = 2.0 * max(scene.task.start_range_m, scene.task.goal_range_m)
    top_m = 2.0 * scene.object.rest_height_m
    unit_square = np.array([(x, y) for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
    corners = []
    for mark in marks(scene):
        outline = np.add(mark.xy_m, unit_square * np.add(mark.size_m, reach_m))
        for z in (0.0, top_m):
            corners.append(np.insert(outline, 2, z, axis=1))
    right, up, back = ((np.vstack(corners) - _HIGH_AT) @ R).T
    across = right * scene.camera.height_px / scene.camera.width_px
    tangents = np.abs([across, up]) / -back
    needed_deg = float(2.0 * np.degrees(np.arctan(tangents.max())))
    if needed_deg <= _HIGH_FOVY_DEG:
        return _HIGH_FOVY_DEG
    return needed_deg + _HIGH_MARGIN_DEG
