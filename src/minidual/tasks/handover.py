"""Handover: the left hand fetches a bottle, the right takes it in the air."""

import numpy as np

from minidual.config.change import preset
from minidual.config.root import Config
from minidual.robot.poses import pose, rot_x, rot_z
from minidual.tasks import success
from minidual.tasks.rod_carry import draw_on_table, transported
from minidual.tasks.task import Step, Task, TaskObject, Trial

_L, _R = ("left",), ("right",)
_MEETINGS = tuple(
    pose(rot_z(yaw), xyz)
    for yaw, xyz in ((0.1, (0.56, -0.03, 0.30)), (0.1, (0.56, -0.10, 0.30)), (0.1, (0.60, -0.05, 0.35)))
)
"""Exchange poses; the bottle's x axis points to the right hand."""
_STEPS = (
    *(Step(phase, _L) for phase in ("approach", "descend", "close", "lift")),
    Step("carry", _L, places=_MEETINGS),
    *(Step(phase, _R) for phase in ("approach", "descend", "close")),
    *(Step(phase, _L) for phase in ("open", "retreat", "home")),
    *(Step(phase, _R) for phase in ("carry", "lower", "open", "retreat", "home")),
)
_FROM_THE_SIDE = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
"""Hand pointing along the bottle's x axis, closing along y."""


def handover(config: Config) -> Task:
    """Return the task."""
    config = preset(
        config,
        {
            "scene.object.name": "bottle",
            "scene.object.shape": "box",
            "scene.object.upright": True,
            "scene.object.length_m": 0.20,
            "scene.object.width_m": 0.05,
            "scene.object.height_m": 0.05,
            "scene.object.mass_kg": 0.3,
            "scene.object.friction": 0.8,
            "scene.object.grasp_offset_m": 0.07,
            "scene.object.colour": (0.16, 0.45, 0.36, 1.0),
            "scene.task.start_xy_m": (0.42, 0.58),
            "scene.task.start_range_m": 0.03,
            "scene.task.goal_xy_m": (0.50, -0.60),
            "scene.task.goal_yaw_rad": -0.7,
            "scene.task.lift_height_m": 0.10,
            "scene.task.time_limit_s": 25.0,
            "scene.task.tilt_max_rad": 0.20,
        },
    )
    body = config.scene.object
    return Task(
        name="handover",
        instruction=f"Take the {body.name} with the left hand, pass it to the right one and stand it on the green mark.",
        config=config,
        objects={
            body.name: TaskObject(
                body,
                {
                    "left": pose(rot_z(np.pi / 2.0) @ rot_x(np.pi), (0.0, 0.0, body.grasp_offset_m)),
                    "right": pose(_FROM_THE_SIDE, (0.0, 0.0, 0.0)),
                },
            )
        },
        steps=_STEPS,
        success=handed_over,
        draw=draw_on_table,
        stream="handover-trial",
    )


def handed_over(task: Task, trial: Trial) -> tuple[success.SuccessCondition, ...]:
    """Return the conditions."""
    level, held, carried, rose, *rest = transported(task, trial, both=False)
    exchanged = success.Exchanged(task.carried, task.scene.task.pinch_min_n)
    return level, held, carried, rose, exchanged, *rest
