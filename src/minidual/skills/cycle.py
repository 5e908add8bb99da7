"""Convert a task to the planner's object, scene and stages."""

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial

import numpy as np

from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import IDENTITY, Box, Cylinder, Mesh
from minidual.config.scene import OBSTACLE, ObjectConfig, PartConfig, SceneConfig
from minidual.control.bounds import Reach
from minidual.errors import UsageError, check_name
from minidual.motion.api import Planner
from minidual.robot.pair import SIDES, Array, Robot
from minidual.skills.phases import PHASES, State, Thing
from minidual.skills.pipeline.carrying import Carry, Place
from minidual.skills.pipeline.hands import (
    Grip,
    close,
    descend,
    home,
    insert,
    open_hands,
    reach,
    retreat,
)
from minidual.skills.pipeline.search import Pipeline, Solution, TaskFailedError
from minidual.skills.pipeline.stage import Gap, Stage, Tools
from minidual.skills.supervised import arm_distance
from minidual.tasks.task import Step, Task, Trial, pose_of

_ALONG_Y = (0.5**0.5, -(0.5**0.5), 0.0, 0.0)
_PRISM = 16  # sides of the prism round a cylinder
_KEENNESS = 0.5  # where grasps can be chosen, the cheapest of all plans would take too long to find
_BY_FORCE = ("squeeze", "settle", "unload")
_CARRYING = ("lift", "carry", "lower")
_CLEAR_M = 0.005  # over the height that the task asks for, and the distance of the arms
_GAP_MARGIN_M = 0.005
_PLANNED_TILT = (
    0.9  # share of the task's limit; driven, the object tilts a little more than planned
)
_OF_HANDS = {
    "descend": descend,
    "close": close,
    "open": open_hands,
    "retreat": retreat,
    "home": home,
}


def thing_of(body: ObjectConfig) -> Thing:
    """Return the planner's object."""
    part, *others = body.solids
    if others:
        pieces = tuple(_corners(part).tobytes() for part in body.solids)
        return Thing(Mesh(body.name, (0.0, 0.0, 0.0), pieces=pieces), upright=body.upright)
    return Thing(shape_of(body.name, part), upright=body.upright)


def shape_of(name: str, part: PartConfig) -> Box | Cylinder:
    """Return a part as the planner's shape."""
    if part.shape == "box":
        return Box(name, part.position_m, size_m=part.size_m)
    x, y, z = part.size_m
    quat, length_m = (IDENTITY, z) if part.axis == "z" else (_ALONG_Y, y)
    return Cylinder(name, part.position_m, quat, x / 2, length_m)


def _corners(part: PartConfig) -> Array:
    if part.shape == "box":
        ring = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
    else:
        angles = np.arange(_PRISM) * math.tau / _PRISM
        ring = np.c_[np.cos(angles), np.sin(angles)] / math.cos(math.pi / _PRISM)
    ends = [np.insert(ring, "xyz".index(part.axis), end, axis=1) for end in (-1.0, 1.0)]
    return np.vstack(ends) * part.half_m + part.position_m


def around(scene: SceneConfig, robot: Robot) -> PlanningScene:
    """Return a task's obstacles."""
    room = PlanningScene(robot=robot)
    block = scene.task.obstacle
    if block is None:
        return room
    return room.with_obstacles(
        Box(OBSTACLE, (*block.xy_m, block.size_m[2] / 2), size_m=block.size_m),
    )


def pipeline_of(task: Task, trial: Trial, steps: Sequence[Step] | None = None) -> Pipeline:
    """Return the stages of position-driven steps, by default the task's; force-driven steps are omitted.

    Raises:
        UsageError: Unknown phase or object, or missing grasp.
    """
    asked = task.scene.task
    stages = list[Stage]()
    taken = Counter[str]()
    steps = [
        step for step in (task.steps if steps is None else steps) if step.phase not in _BY_FORCE
    ]
    for step in steps:
        check_name("phase", step.phase, PHASES)
        for name in step.objects:
            check_name("object", name, task.objects)

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
            asked_for = [
                T if isinstance(T, Mapping) else {handled[0]: T}
                for step in moves
                for T in step.places
            ]
            if not (
                places := [
                    Place(f"place {k + 1}", Ts, 0.5 * k, rests) for k, Ts in enumerate(asked_for)
                ]
            ):
                goals = {
                    name: pose_of(task.objects[name].body, trial.goal[name]) for name in handled
                }
                places = [Place("the goal", goals)]
            least_m = asked.clear_height_m + _CLEAR_M
            carry = Carry(places, asked.lift_height_m, _PLANNED_TILT * asked.tilt_max_rad, least_m)
            stages.append(Stage(label("carry", hands, names), carry.offers))
            continue
        for step in run:
            if step.phase == "insert":
                offers = partial(insert, hands, [np.asarray(T) for T in step.places], *handled)
            elif step.phase == "approach":
                ways = [{hands[0]: T} for T in step.grasps]
                for hand, name in about.items() if not ways else ():
                    if hand not in (grasps := task.objects[name].grasps):
                        raise UsageError(
                            f"the {hand} hand has no grasp of '{name}'; there are {', '.join(grasps)}",
                        )
                ways = ways or [
                    {hand: task.objects[name].grasps[hand] for hand, name in about.items()},
                ]
                grips = [Grip(f"grasp {k + 1}", way, float(k)) for k, way in enumerate(ways)]
                offers = partial(reach, hands, grips, about)
            else:
                offers = partial(_OF_HANDS[step.phase], hands)
            stages.append(Stage(label(step.phase, hands, names), offers))
    return Pipeline(task.name, stages, _KEENNESS if any(step.grasps for step in steps) else 0.0)


def solve(
    task: Task,
    trial: Trial,
    start: State,
    planner: Planner,
    seed: int = 0,
    apart_m: float | None = None,
    by_force: bool = False,
) -> Solution:
    """Return a plan of the whole task from `start`, by the first arrangement of its steps that has one.

    The arms keep `apart_m` and a margin apart.

    Raises:
        TaskFailedError: Of the last arrangement.
    """
    things = {item.body.name: thing_of(item.body) for item in task.objects.values()}
    far = arm_distance(planner.robot), Reach(planner.kinematics).m
    gap = None if apart_m is None else Gap(*far, apart_m + _GAP_MARGIN_M)
    room_m = planner.robot.hand.travel_m - min(
        item.body.half_width_m for item in task.objects.values()
    )
    fingers_s = room_m / task.config.arbiter.finger_speed_m_per_s
    tools = Tools(
        around(task.scene, planner.robot),
        things,
        planner,
        seed,
        gap,
        by_force,
        fingers_s,
    )
    ways = [task.steps] if task.arrange is None else task.arrange(task, trial, start.objects)
    *others, last = (pipeline_of(task, trial, steps) for steps in ways)
    for pipeline in others:
        with suppress(TaskFailedError):
            return pipeline.solve(start, tools)
    return last.solve(start, tools)
