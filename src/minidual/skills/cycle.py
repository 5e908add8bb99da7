"""From a task to what plans it: its object and surroundings for the planner, its steps as stages."""

from __future__ import annotations

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box, Capsule
from minidual.config.scene import ObjectConfig, SceneConfig
from minidual.robot.arms import DUAL_PANDA
from minidual.robot.pair import SIDES, Array, Robot
from minidual.skills.pipeline.carrying import Carry, Place
from minidual.skills.pipeline.hands import Close, Descend, Grip, Open, Reach, Retreat
from minidual.skills.pipeline.search import Pipeline
from minidual.skills.pipeline.state import Thing
from minidual.tasks.rod_carry import grasp_offsets

_ALONG_Y = (0.5**0.5, -(0.5**0.5), 0.0, 0.0)


def thing_of(body: ObjectConfig, name: str) -> Thing:
    """Return an object for the planner; a cylinder lies along its own y axis, its ends rounded inside its length."""
    if body.shape == "box":
        return Thing(Box(name, (0.0, 0.0, 0.0), size_m=(body.width_m, body.length_m, body.height_m)))
    length = body.length_m - 2.0 * body.radius_m
    return Thing(Capsule(name, (0.0, 0.0, 0.0), _ALONG_Y, radius_m=body.radius_m, length_m=length))


def around(scene: SceneConfig, robot: Robot = DUAL_PANDA) -> PlanningScene:
    """Return what stands in the way of a task."""
    block = scene.task.obstacle
    if block is None:
        return PlanningScene(robot=robot)
    x, y = block.xy_m
    box = Box("obstacle", (x, y, block.size_m[2] / 2), size_m=block.size_m)
    return PlanningScene(robot=robot).with_obstacles(box)


def carry_pipeline(scene: SceneConfig, T_world_goal: Array) -> Pipeline:
    """Return the stages of fetching the object with both hands and putting it down at a pose (4, 4)."""
    grip = Grip("both hands", dict(zip(SIDES, grasp_offsets(scene), strict=True)))
    return Pipeline(
        "carry",
        [
            Reach("approach", SIDES, [grip]),
            Descend("descend", SIDES),
            Close("close", SIDES),
            Carry("carry", [Place("the goal", T_world_goal)], scene.task.lift_height_m),
            Open("open", SIDES),
            Retreat("retreat", SIDES),
        ],
    )
