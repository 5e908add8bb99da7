"""Both arms carry a long object across the table."""

from dataclasses import dataclass

import numpy as np

from minidual.config.root import Config, preset
from minidual.config.scene import OBSTACLE
from minidual.errors import UsageError
from minidual.robot.pair import SIDES
from minidual.tasks import movement, success
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
    grasp = f"Grasp the {config.scene.object.name} with both hands"
    instruction = f"{grasp}, carry it to the green mark and put it down."
    return carry_task("rod_carry", instruction, config, "rod-trial")


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
    ranges = task.scene.task
    obstacle = ranges.obstacle
    body = task.scene.object
    name = task.carried
    for _ in range(_DRAWS_MAX):
        start = near(
            rng,
            (*ranges.start_xy_m, 0.0),
            widen * ranges.start_range_m,
            widen * ranges.start_range_rad,
        )
        goal = near(
            rng,
            (*ranges.goal_xy_m, ranges.goal_yaw_rad),
            ranges.goal_range_m,
            ranges.goal_range_rad,
        )
        if obstacle is None or (beside(body, obstacle, start) and beside(body, obstacle, goal)):
            return {name: start}, {name: goal}
    raise UsageError(
        f"'{name}' has no room beside the obstacle",
        remedy="move scene.task.start_xy_m or goal_xy_m away",
    )


@dataclass(frozen=True)
class TransportConditions:
    """Conditions of a transport over the table."""

    level: success.Level
    held: success.Held
    slow: movement.Slow
    carried: movement.Carried
    rose: success.Rose
    arrived: success.Arrived
    turned: success.Turned
    released: success.Released
    settled: movement.Settled
    at_rest: success.AtRest
    on_time: success.OnTime


def transported(task: Task, trial: Trial, *, both: bool = True) -> TransportConditions:
    """Return the conditions of a transport by both hands, or by one."""
    limits = task.scene.task
    name = task.carried
    x, y, yaw = placement(trial.goal[name])
    high_m = movement.HIGH_SHARE * limits.clear_height_m
    return TransportConditions(
        level=success.Level(name, limits.tilt_max_rad),
        held=success.Held(name, limits.pinch_min_n, both),
        slow=movement.Slow(name),
        carried=movement.Carried(name, high_m),
        rose=success.Rose(name, limits.clear_height_m),
        arrived=success.Arrived(name, (x, y), limits.goal_tolerance_m),
        turned=success.Turned(
            name,
            yaw,
            limits.yaw_tolerance_rad,
            task.objects[name].symmetry,
        ),
        released=success.Released(name),
        settled=movement.Settled(name, high_m),
        at_rest=success.AtRest(name, limits.rest_speed_m_per_s),
        on_time=success.OnTime(limits.time_limit_s),
    )


def carried_by_both(task: Task, trial: Trial) -> tuple[success.SuccessCondition, ...]:
    """Return the conditions."""
    limits = task.scene.task
    name = task.carried
    body = task.scene.object
    transport = transported(task, trial)
    clear = () if limits.obstacle is None else (success.Clear(OBSTACLE),)
    return (
        transport.level,
        success.Whole(name, body.break_pinch_n, body.break_force_n),
        *clear,
        transport.held,
        transport.slow,
        transport.carried,
        success.Squeezed(name, limits.internal_force_min_n),
        transport.rose,
        transport.arrived,
        transport.turned,
        transport.released,
        transport.settled,
        transport.at_rest,
        transport.on_time,
    )
