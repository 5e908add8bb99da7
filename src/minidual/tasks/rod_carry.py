"""Both arms carry a long object across the table."""

import math

import numpy as np

from minidual.config.root import Config, preset
from minidual.config.scene import OBSTACLE, ObjectConfig, ObstacleConfig, SceneConfig
from minidual.errors import UsageError
from minidual.robot.pair import SIDES, Array
from minidual.robot.poses import pose, rot_x, rot_z
from minidual.tasks import success
from minidual.tasks.objects import MOTIONS, OBJECTS
from minidual.tasks.task import ObjectPose, Poses, Step, Task, TaskObject, Trial

DOWN = rot_z(np.pi / 2.0) @ rot_x(np.pi)
"""Orientation (3, 3) of a hand over an object that lies along y."""
_DRAWS_MAX, _ROOM_M = 1000, 0.02
_PHASES = ("approach", "descend", "close", "squeeze", "lift", "carry", "lower", "open", "retreat")


def carry_config(config: Config) -> Config:
    """Return the configuration with object and motion applied; idempotent.

    Raises:
        UsageError: Unknown object or motion.
    """
    item, motion = OBJECTS[config.carry.object], MOTIONS[config.carry.motion]
    return preset(config, {"scene.object.name": config.carry.object, **item, **motion})


def rod_carry(config: Config) -> Task:
    """Return the task."""
    config = carry_config(config)
    what = f"Grasp the {config.scene.object.name} with both hands, carry it to the green mark and put it down."
    return carry_task("rod_carry", what, config, "rod-trial")


def carry_task(name: str, instruction: str, config: Config, stream: str) -> Task:
    """Return a task in which both hands carry `scene.object`."""
    body, grasps = config.scene.object, dict(zip(SIDES, grasp_offsets(config.scene), strict=True))
    return Task(
        name=name,
        instruction=instruction,
        config=config,
        objects={body.name: TaskObject(body, grasps, symmetry=2)},
        steps=tuple(Step(phase) for phase in _PHASES),
        success=carried_by_both,
        draw=draw_on_table,
        stream=stream,
    )


def draw_on_table(task: Task, rng: np.random.Generator, widen: float = 1.0) -> tuple[Poses, Poses]:
    """Draw start and goal uniformly, beside the obstacle.

    Raises:
        UsageError: There is no room beside it.
    """
    asked, name = task.scene.task, task.carried
    for _ in range(_DRAWS_MAX):
        dx, dy = widen * asked.start_range_m * rng.uniform(-1.0, 1.0, size=2)
        yaw = widen * asked.start_range_rad * rng.uniform(-1.0, 1.0)
        start = (asked.start_xy_m[0] + float(dx), asked.start_xy_m[1] + float(dy), float(yaw))
        gx, gy, turn = (asked.goal_range_m, asked.goal_range_m, asked.goal_range_rad) * rng.uniform(-1.0, 1.0, size=3)
        x, y = asked.goal_xy_m
        goal = (x + float(gx), y + float(gy), asked.goal_yaw_rad + float(turn))
        if asked.obstacle is None or all(beside(task.scene.object, asked.obstacle, place) for place in (start, goal)):
            return {name: start}, {name: goal}
    raise UsageError(f"'{name}' has no room beside the obstacle", remedy="move scene.task.start_xy_m or goal_xy_m away")


def beside(body: ObjectConfig, block: ObstacleConfig, place: tuple[float, float, float]) -> bool:
    """Return whether a body at (x, y, yaw) keeps 2 cm from a block."""
    (x, y, yaw), parts = place, body.solids
    a, b = (max(abs(part.position_m[k]) + part.half_m[k] for part in parts) for k in (0, 1))
    c, s = abs(math.cos(yaw)), abs(math.sin(yaw))
    away = abs(x - block.xy_m[0]) - c * a - s * b, abs(y - block.xy_m[1]) - s * a - c * b
    return any(gap > size / 2 + _ROOM_M for gap, size in zip(away, block.size_m, strict=False))


def carried_by_both(task: Task, trial: Trial) -> tuple[success.SuccessCondition, ...]:
    """Return the conditions."""
    asked, name, body = task.scene.task, task.carried, task.scene.object
    level, held, carried, *rest = transported(task, trial)
    whole = success.Whole(name, body.break_pinch_n, body.break_force_n)
    clear = () if asked.obstacle is None else (success.Clear(OBSTACLE),)
    return level, whole, *clear, held, carried, success.Squeezed(name, asked.internal_force_min_n), *rest


def transported(task: Task, trial: Trial, *, both: bool = True) -> list[success.SuccessCondition]:
    """Return the conditions of a transport by both hands or one."""
    asked, name = task.scene.task, task.carried
    start, (x, y, yaw) = placement(trial.start[name]), placement(trial.goal[name])
    return [
        success.Level(name, asked.tilt_max_rad),
        success.Held(name, asked.pinch_min_n, both),
        success.Carried(name, start[:2], (x, y)),
        success.Rose(name, asked.clear_height_m),
        success.Arrived(name, (x, y), asked.goal_tolerance_m),
        success.Turned(name, yaw, asked.yaw_tolerance_rad, task.objects[name].symmetry),
        success.Released(name),
        success.AtRest(name, asked.rest_speed_m_per_s),
        success.OnTime(asked.time_limit_s),
    ]


def placement(pose: ObjectPose) -> tuple[float, float, float]:
    """Return (x [m], y [m], yaw [rad]) of an object pose."""
    if isinstance(pose, tuple):
        return pose
    return float(pose[0, 3]), float(pose[1, 3]), float(np.arctan2(-pose[0, 1], pose[1, 1]))


def level_pose(x: float, y: float, z: float, yaw_rad: float) -> Array:
    """Return the pose (4, 4) of a level object."""
    return pose(rot_z(yaw_rad), (x, y, z))


def level_part(T_world_object: Array) -> Array:
    """Return the pose without tilt or roll."""
    return pose(rot_z(placement(T_world_object)[2]), T_world_object[:3, 3])


def grasp_offsets(scene: SceneConfig) -> tuple[Array, Array]:
    """Return left and right T_object_tcp, pointing down; left is the +y end."""
    y, z = scene.object.grasp_offset_m, scene.object.grasp_height_m
    return pose(DOWN, (0.0, y, z)), pose(DOWN, (0.0, -y, z))


def tilt_rad(T_world_object: Array, body: ObjectConfig) -> float:
    """Return the long axis' tilt."""
    if body.upright:
        return math.acos(min(1.0, abs(T_world_object.item(2, 2))))
    return math.asin(min(1.0, abs(T_world_object.item(2, 1))))
