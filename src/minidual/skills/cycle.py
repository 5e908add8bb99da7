"""Convert a task to the planner's object, scene and stages."""

import itertools

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import IDENTITY, Box, Cylinder
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
from minidual.tasks.task import Task, Trial

_ALONG_Y = (0.5**0.5, -(0.5**0.5), 0.0, 0.0)
_BY_FORCE = ("squeeze", "settle", "unload")
_CARRYING = ("lift", "carry", "lower")
_PLANNED_TILT = 0.9  # share of the task's limit; driven, the object tilts a little more than planned
_OF_HANDS = {"descend": Descend, "close": Close, "open": Open, "retreat": Retreat, "home": Home}


def thing_of(body: ObjectConfig) -> Thing:
    """Return the planner's object."""
    if body.shape == "box":
        x, y, z = (2.0 * half for half in body.half_sizes_m)
        return Thing(Box(body.name, (0.0, 0.0, 0.0), size_m=(x, y, z)), upright=body.upright)
    quat = IDENTITY if body.upright else _ALONG_Y
    shape = Cylinder(body.name, (0.0, 0.0, 0.0), quat, body.radius_m, body.length_m)
    return Thing(shape, upright=body.upright)


def around(scene: SceneConfig, robot: Robot = DUAL_PANDA) -> PlanningScene:
    """Return a task's obstacles."""
    room, block = PlanningScene(robot=robot), scene.task.obstacle
    if block is None:
        return room
    return room.with_obstacles(Box(OBSTACLE, (*block.xy_m, block.size_m[2] / 2), size_m=block.size_m))


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
    name, stages = task.carried, list[Stage]()
    item = task.objects[name]
    goal = Place("the goal", pose_of(item.body, trial.goal[name]))
    steps = [step for step in task.steps if step.phase not in _BY_FORCE]
    for step in steps:
        if step.phase not in PHASES:
            raise unknown_name("phase", step.phase, PHASES)
        if step.object not in ("", name):
            raise UsageError(f"step '{step.phase}' is about '{step.object}'; a plan handles one object, '{name}'")
    for (carrying, hands), run in itertools.groupby(steps, lambda step: (step.phase in _CARRYING, step.hands)):
        of_hands = "" if len(hands) == len(SIDES) else f" {hands[0]}"
        if carrying:  # one stage for lift, carry and lower
            moves, asked = list(run), task.scene.task
            rests = any(step.phase == "lower" for step in moves)
            poses = [T for step in moves for T in step.places]
            places = [Place(f"place {k + 1}", T, 0.5 * k, rests) for k, T in enumerate(poses)] or [goal]
            stages.append(Carry(f"carry{of_hands}", places, asked.lift_height_m, _PLANNED_TILT * asked.tilt_max_rad))
            continue
        for step in run:
            label = f"{step.phase}{of_hands}"
            if step.phase != "approach":
                stages.append(_OF_HANDS[step.phase](label, hands))
                continue
            bare = [hand for hand in hands if hand not in item.grasps]
            if bare:
                raise UsageError(f"the {bare[0]} hand has no grasp of '{name}'; there are {', '.join(item.grasps)}")
            stages.append(Reach(label, hands, [Grip("as given", {hand: item.grasps[hand] for hand in hands})]))
    return Pipeline(task.name, stages)
