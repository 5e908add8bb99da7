"""Convert a task to planner objects, scene and stages."""

from __future__ import annotations

from collections.abc import Sequence

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Box, Capsule
from minidual.config.scene import ObjectConfig, SceneConfig
from minidual.errors import UsageError, unknown_name
from minidual.plant.bodies import ObjectPose
from minidual.plant.scenery import OBSTACLE
from minidual.robot.arms import DUAL_PANDA
from minidual.robot.pair import SIDES, Array, Robot
from minidual.robot.poses import pose, rot_z
from minidual.skills.phases import PHASES
from minidual.skills.pipeline.carrying import Carry, Place
from minidual.skills.pipeline.hands import Close, Descend, Grip, Home, Open, Reach, Retreat
from minidual.skills.pipeline.search import Pipeline
from minidual.skills.pipeline.stage import Stage
from minidual.skills.pipeline.state import Thing
from minidual.tasks.task import Step, Task, Trial

_ALONG_Y = (0.5**0.5, -(0.5**0.5), 0.0, 0.0)
_UPRIGHT = (1.0, 0.0, 0.0, 0.0)
_BY_FORCE = ("squeeze", "settle", "unload")
_CARRYING = ("lift", "carry", "lower")
_OF_HANDS = {"descend": Descend, "close": Close, "open": Open, "retreat": Retreat, "home": Home}


def thing_of(body: ObjectConfig) -> Thing:
    """Return the planner's object; a cylinder becomes an inscribed capsule, which leaves its end rims out."""
    if body.shape == "box":
        x, y, z = (2.0 * half for half in body.half_sizes_m)
        return Thing(Box(body.name, (0.0, 0.0, 0.0), size_m=(x, y, z)), upright=body.upright)
    quat, length = _UPRIGHT if body.upright else _ALONG_Y, body.length_m - 2.0 * body.radius_m
    return Thing(
        Capsule(body.name, (0.0, 0.0, 0.0), quat, radius_m=body.radius_m, length_m=length), upright=body.upright
    )


def around(scene: SceneConfig, robot: Robot = DUAL_PANDA) -> PlanningScene:
    """Return a task's obstacles."""
    block = scene.task.obstacle
    if block is None:
        return PlanningScene(robot=robot)
    x, y = block.xy_m
    box = Box(OBSTACLE, (x, y, block.size_m[2] / 2), size_m=block.size_m)
    return PlanningScene(robot=robot).with_obstacles(box)


def pose_of(body: ObjectConfig, where: ObjectPose) -> Array:
    """Return the pose (4, 4) for a pose or (x, y, yaw) on the table."""
    if not isinstance(where, tuple):
        return where
    x, y, yaw = where
    return pose(rot_z(yaw), (x, y, body.rest_height_m))


def pipeline_of(task: Task, trial: Trial) -> Pipeline:
    """Return the stages of a task's position-driven steps; force-driven steps are omitted.

    Raises:
        UsageError: Unknown phase, wrong object, or missing grasp.
    """
    name = task.carried
    item = task.objects[name]
    goal = Place("the goal", pose_of(item.body, trial.goal[name]))
    stages: list[Stage] = []
    steps = [step for step in task.steps if step.phase not in _BY_FORCE]
    for index, step in enumerate(steps):
        if step.phase not in PHASES:
            raise unknown_name("phase", step.phase, PHASES)
        if step.object not in ("", name):
            raise UsageError(f"step '{step.phase}' is about '{step.object}'; a plan handles one object, '{name}'")
        label = step.phase if len(step.hands) == len(SIDES) else f"{step.phase} {step.hands[0]}"
        if step.phase == "approach":
            bare = [hand for hand in step.hands if hand not in item.grasps]
            if bare:
                raise UsageError(f"the {bare[0]} hand has no grasp of '{name}'; there are {', '.join(item.grasps)}")
            stages.append(
                Reach(label, step.hands, [Grip("as given", {hand: item.grasps[hand] for hand in step.hands})])
            )
        elif step.phase in _CARRYING:
            following = steps[index + 1] if index + 1 < len(steps) else None
            if following is None or following.phase not in _CARRYING or following.hands != step.hands:
                stages.append(_carry(task, _run_of(steps, index), goal))
        else:
            stages.append(_OF_HANDS[step.phase](label, step.hands))
    return Pipeline(task.name, stages)


def _run_of(steps: Sequence[Step], last: int) -> Sequence[Step]:
    """Return the carrying steps of the same hands up to index `last`."""
    first = last
    while first > 0 and steps[first - 1].phase in _CARRYING and steps[first - 1].hands == steps[last].hands:
        first -= 1
    return steps[first : last + 1]


def _carry(task: Task, steps: Sequence[Step], goal: Place) -> Carry:
    """Return one stage for lift, carry and lower."""
    rests = any(step.phase == "lower" for step in steps)
    poses = [T for step in steps for T in step.places]
    places = [Place(f"place {k + 1}", T, 0.5 * k, rests) for k, T in enumerate(poses)] or [goal]
    hands = steps[0].hands
    label, asked = "carry" if len(hands) == len(SIDES) else f"carry {hands[0]}", task.scene.task
    return Carry(label, places, asked.lift_height_m, asked.tilt_max_rad)
