"""The rod task: where a trial starts, where it must end, and where the hands belong on the rod."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from minidual.config.scene import SceneConfig
from minidual.config.seeds import stream
from minidual.robot.constants import Array
from minidual.robot.poses import pose, rot_x, rot_z


@dataclass(frozen=True)
class RodTrial:
    """One randomised trial.

    Attributes:
        purpose: Name of the random stream, e.g. `carry` or `demonstrations`.
        index: Number of the trial in its stream.
        start: (x [m], y [m], yaw [rad]) of the rod on the table.
        goal: (x [m], y [m], yaw [rad]) where it must be put down.
    """

    purpose: str
    index: int
    start: tuple[float, float, float]
    goal: tuple[float, float, float]


def sample_trial(scene: SceneConfig, seed: int, purpose: str, index: int, *, widen: float = 1.0) -> RodTrial:
    """Draw trial `index` of a purpose: start uniform within the task's range, goal fixed.

    Args:
        scene: Holds nominal poses and ranges.
        seed: The run's seed.
        purpose: Stream name; different purposes never share trials.
        index: Trial number.
        widen: Scale of the range; demonstrations may cover more than the tests ask.
    """
    rng = stream(seed, f"rod-trial/{purpose}", index)
    task = scene.task
    dx, dy = widen * task.start_range_m * rng.uniform(-1.0, 1.0, size=2)
    yaw = widen * task.start_range_rad * rng.uniform(-1.0, 1.0)
    start = (task.start_xy_m[0] + float(dx), task.start_xy_m[1] + float(dy), float(yaw))
    return RodTrial(purpose, index, start, (*task.goal_xy_m, task.goal_yaw_rad))


def level_pose(x: float, y: float, z: float, yaw_rad: float) -> Array:
    """Return the pose (4, 4) of a level rod whose long axis (y) is turned by yaw about the vertical."""
    return pose(rot_z(yaw_rad), (x, y, z))


def level_part(T_world_rod: Array) -> Array:
    """Return the rod's pose with roll about its own axis and tilt removed.

    A cylinder may have rolled on the table; the hands care for the direction of its axis alone.
    """
    axis = T_world_rod[:3, 1]
    yaw = float(np.arctan2(-axis[0], axis[1]))
    return pose(rot_z(yaw), T_world_rod[:3, 3])


def grasp_offsets(scene: SceneConfig) -> tuple[Array, Array]:
    """Return (T_rod_left_tcp, T_rod_right_tcp), each (4, 4), in the rod's level frame.

    Hands point down and the fingers close across the rod; the left hand holds the +y end.
    """
    rotation = rot_z(np.pi / 2.0) @ rot_x(np.pi)
    offset, height = scene.rod.grasp_offset_m, scene.rod.grasp_height_m
    left, right = (pose(rotation, (0.0, sign * offset, height)) for sign in (1.0, -1.0))
    return left, right


def tilt_rad(T_world_rod: Array) -> float:
    """Return the angle between the rod's axis and the horizontal [rad]."""
    return float(np.arcsin(min(1.0, abs(T_world_rod[2, 1]))))
