"""Both arms carry a long object across the table."""

import numpy as np

from minidual.config.root import Config, preset
from minidual.config.scene import OBSTACLE
from minidual.errors import UsageError
from minidual.robot.pair import SIDES
from minidual.tasks import success
from minidual.tasks.objects import MOTIONS, OBJECTS, with_pinch
from minidual.tasks.task import (
    Poses,
    Step,
    Task,
    TaskObject,
    Trial,
    beside,
    grasp_offsets,
    near,
    placement,
)

_DRAWS_MAX = 1000
_PHASES = ("approach", "descend", "close", "squeeze", "lift", "carry", "lower", "open", "retreat")


def carry_config(config: Config) -> Config:
    """Return the configuration with object and motion applied; idempotent.

    Raises:
        UsageError: Unknown object or motion.
    """
    item = with_pinch(OBJECTS[config.carry.object])
    motion = MOTIONS[config.carry.motion]
    return preset(config, {"scene.object.name": config.carry.object, **item, **motion})


def rod_carry(config: Config) -> Task:
    """Return the task."""
    config = carry_config(config)
    what = f"Grasp the {config.scene.object.name} with both hands, carry it to the green mark and put it down."
    return carry_task("rod_carry", what, config, "rod-trial")


def carry_task(name: str, instruction: str, config: Config, stream: str) -> Task:
    """Return a task in which both hands carry `scene.object`."""
    body = config.scene.object
    grasps = dict(zip(SIDES, grasp_offsets(config.scene), strict=True))
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
    asked = task.scene.task
    name = task.carried
    for _ in range(_DRAWS_MAX):
        start = near(
            rng,
            (*asked.start_xy_m, 0.0),
            widen * asked.start_range_m,
            widen * asked.start_range_rad,
        )
        goal = near(
            rng,
            (*asked.goal_xy_m, asked.goal_yaw_rad),
            asked.goal_range_m,
            asked.goal_range_rad,
        )
        if asked.obstacle is None or all(
            beside(task.scene.object, asked.obstacle, place) for place in (start, goal)
        ):
            return {name: start}, {name: goal}
    raise UsageError(
        f"'{name}' has no room beside the obstacle",
        remedy="move scene.task.start_xy_m or goal_xy_m away",
    )


def carried_by_both(task: Task, trial: Trial) -> tuple[success.SuccessCondition, ...]:
    """Return the conditions."""
    asked = task.scene.task
    name = task.carried
    body = task.scene.object
    level, held, carried, *rest = transported(task, trial)
    whole = success.Whole(name, body.break_pinch_n, body.break_force_n)
    clear = () if asked.obstacle is None else (success.Clear(OBSTACLE),)
    return (
        level,
        whole,
        *clear,
        held,
        carried,
        success.Squeezed(name, asked.internal_force_min_n),
        *rest,
    )


def transported(task: Task, trial: Trial, *, both: bool = True) -> list[success.SuccessCondition]:
    """Return the conditions of a transport by both hands or one."""
    asked = task.scene.task
    name = task.carried
    start = placement(trial.start[name])
    (x, y, yaw) = placement(trial.goal[name])
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
