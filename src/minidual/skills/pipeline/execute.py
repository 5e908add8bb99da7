"""Drive a solved task in the simulator, through the same joint loop as every other source of joint targets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from minidual.control.loop import JointLoop
from minidual.plant.world import World
from minidual.robot.constants import DOF, Array
from minidual.robot.kinematics import Kinematics
from minidual.skills.pipeline.search import Solution
from minidual.skills.pipeline.state import Segment


@dataclass(frozen=True)
class Driven:
    """What happened while one segment was driven.

    Attributes:
        stage: Its stage.
        duration_s: Simulated time.
        tracking_max_rad: Largest distance of a joint from its reference.
        object_off_max_m: Largest distance of the carried object from its planned place; None where none is planned.
    """

    stage: str
    duration_s: float
    tracking_max_rad: float
    object_off_max_m: float | None


def execute(solution: Solution, world: World, *, on_step: Callable[[str], None] | None = None) -> tuple[Driven, ...]:
    """Drive every segment, one control step a physics step.

    Args:
        solution: Its start must be where the arms are.
        world: The plant; its rod is the task's object.
        on_step: Gets the stage's name after every step.

    Returns:
        One entry a segment.
    """
    loop = JointLoop(world, Kinematics())
    q_end = solution.states[0].q
    driven = []
    for segment in solution.segments:
        driven.append(_drive(segment, q_end, world, loop, on_step))
        if segment.trajectory is not None:
            q_end = segment.trajectory.q[-1]
    return tuple(driven)


def _drive(
    segment: Segment, q_hold: Array, world: World, loop: JointLoop, on_step: Callable[[str], None] | None
) -> Driven:
    still = np.zeros(DOF)
    opening = np.array(segment.openings)
    worst_rad, worst_m = 0.0, None
    steps = max(1, round(segment.duration_s / world.dt))
    for k in range(1, steps + 1):
        t = k * world.dt
        q, v, a = (q_hold, still, still) if segment.trajectory is None else segment.trajectory.sample(t)
        loop.follow(q, v, a, opening)
        worst_rad = max(worst_rad, float(np.max(np.abs(world.q - q))))
        if segment.Ts_world_object is not None and segment.trajectory is not None:
            row = min(round(t / segment.trajectory.dt_s), len(segment.Ts_world_object) - 1)
            off = float(np.linalg.norm(world.object_pose()[:3, 3] - segment.Ts_world_object[row, :3, 3]))
            worst_m = off if worst_m is None else max(worst_m, off)
        if on_step is not None:
            on_step(segment.stage)
    return Driven(segment.stage, steps * world.dt, worst_rad, worst_m)
