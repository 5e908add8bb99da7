"""Convert a task to the planner's object, scene and stages."""

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import IDENTITY, Box, Cylinder
from minidual.config.scene import ObjectConfig, SceneConfig
from minidual.errors import UsageError, unknown_name
from minidual.motion.api import Planner
from minidual.plant.bodies import ObjectPose
from minidual.plant.scenery import OBSTACLE
from minidual.robot.arms import DUAL_PANDA
from minidual.robot.pair import SIDES, Array, Robot
from minidual.robot.poses import pose, rot_z
from minidual.skills.phases import PHASES
from minidual.skills.pipeline.carrying import Carry, Place
from minidual.skills.pipeline.hands import Close, Descend, Grip, Home, Open, Reach, Retreat
from minidual.skills.pipeline.search import Pipeline, Solution, TaskFailedError
from minidual.skills.pipeline.stage import Gap, Stage, Tools
from minidual.skills.pipeline.state import State, Thing
from minidual.tasks.task import Step, Task, Trial

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


def pipeline_of(task: Task, trial: Trial, steps: Sequence[Step] | None = None) -> Pipeline:
    """Return the stages of position-driven steps, by default the task's; force-driven steps are omitted.

    Raises:
        UsageError: Unknown phase or object, or missing grasp.
    """
    asked, stages, taken = task.scene.task, list[Stage](), Counter[str]()
    steps = [step for step in (task.steps if steps is None else steps) if step.phase not in _BY_FORCE]
    for step in steps:
        if step.phase not in PHASES:
            raise unknown_name("phase", step.phase, PHASES)
        for name in step.objects:
            if name not in task.objects:
                raise unknown_name("object", name, task.objects)

    def label(phase: str, hands: Sequence[str], names: Sequence[str]) -> str:
        text = " ".join([phase, *(hands if len(hands) < len(SIDES) else ()), *names])
        taken[text] += 1
        return text if taken[text] == 1 else f"{text} ({taken[text]})"

    def of_run(step: Step) -> tuple[bool, tuple[str, ...], tuple[str, ...]]:
        return step.phase in _CARRYING, step.hands, step.objects

    for (carrying, hands, names), run in itertools.groupby(steps, of_run):
        handled = names or (task.carried,)
        about = dict(zip(hands, handled * len(hands), strict=False))
        if carrying:  # one stage for lift, carry and lower
            moves = list(run)
            rests = any(step.phase == "lower" for step in moves)
            asked_for = [T if isinstance(T, Mapping) else {handled[0]: T} for step in moves for T in step.places]
            places = [Place(f"place {k + 1}", Ts, 0.5 * k, rests) for k, Ts in enumerate(asked_for)]
            if not places:
                goals = {name: pose_of(task.objects[name].body, trial.goal[name]) for name in handled}
                places = [Place("the goal", goals)]
            tilt_rad = _PLANNED_TILT * asked.tilt_max_rad
            stages.append(Carry(label("carry", hands, names), places, asked.lift_height_m, tilt_rad))
            continue
        for step in run:
            if step.phase != "approach":
                stages.append(_OF_HANDS[step.phase](label(step.phase, hands, names), hands))
                continue
            for hand, name in about.items():
                if hand not in (grasps := task.objects[name].grasps):
                    raise UsageError(f"the {hand} hand has no grasp of '{name}'; there are {', '.join(grasps)}")
            grip = Grip("as given", {hand: task.objects[name].grasps[hand] for hand, name in about.items()})
            stages.append(Reach(label("approach", hands, names), hands, [grip], about))
    return Pipeline(task.name, stages)


def solve(task: Task, trial: Trial, start: State, planner: Planner, seed: int = 0, gap: Gap | None = None) -> Solution:
    """Return a plan of the whole task from `start`, by the first arrangement of its steps that has one.

    Raises:
        TaskFailedError: Of the last arrangement.
    """
    things = [thing_of(item.body) for item in task.objects.values()]
    tools = Tools(around(task.scene, planner.robot), things, planner, seed, gap)
    ways = [task.steps] if task.arrange is None else task.arrange(task, trial, start.objects)
    *others, last = (pipeline_of(task, trial, steps) for steps in ways)
    for pipeline in others:
        with suppress(TaskFailedError):
            return pipeline.solve(start, tools)
    return last.solve(start, tools)
