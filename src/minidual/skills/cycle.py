"""Plan a whole task: its steps as stages of a pipeline."""

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import NamedTuple

import numpy as np

from minidual.control.bounds import Reach
from minidual.errors import UsageError, check_name
from minidual.motion.api import Planner
from minidual.robot.pair import SIDES
from minidual.skills.phases import PHASES
from minidual.skills.pipeline.carrying import Carry, Place
from minidual.skills.pipeline.hands import (
    Grip,
    close,
    descend,
    home,
    open_hands,
    reach,
    retreat,
)
from minidual.skills.pipeline.inserting import insert
from minidual.skills.pipeline.search import Pipeline, Solution, TaskFailedError
from minidual.skills.pipeline.stage import Gap, Stage, Tools
from minidual.skills.states import State
from minidual.skills.supervised import arm_distance
from minidual.skills.things import around, thing_of
from minidual.tasks.task import Step, Task, Trial, pose_of

_KEENNESS = 0.5
"""Where grasps can be chosen, finding the cheapest of all plans would take too long."""
_BY_FORCE = ("squeeze", "settle", "unload")
_CARRYING = ("lift", "carry", "lower")
_PLACE_COST = 0.5
"""Of each place after the first."""
_CLEAR_M = 0.005
"""Above the height that the task asks for."""
_GAP_MARGIN_M = 0.005
"""Above the distance that the arms must keep."""
_PLANNED_TILT = 0.9
"""Share of the task's limit; driven, the object tilts a little more than planned."""
_OF_HANDS = {
    "descend": descend,
    "close": close,
    "open": open_hands,
    "retreat": retreat,
    "home": home,
}


class _Run(NamedTuple):
    """State that successive steps share."""

    carrying: bool
    hands: tuple[str, ...]
    objects: tuple[str, ...]


class _Labels:
    """Unique names of stages: phase, hands if not both, objects, and a number if repeated."""

    def __init__(self) -> None:
        self._taken = Counter[str]()

    def label(self, phase: str, run: _Run) -> str:
        hands = run.hands if len(run.hands) < len(SIDES) else ()
        text = " ".join([phase, *hands, *run.objects])
        self._taken[text] += 1
        count = self._taken[text]
        return text if count == 1 else f"{text} ({count})"


def pipeline_of(task: Task, trial: Trial, steps: Sequence[Step] | None = None) -> Pipeline:
    """Return the stages of position-driven steps, by default the task's.

    Force-driven steps are omitted. Successive lift, carry and lower are one stage.

    Raises:
        UsageError: Unknown phase or object, or missing grasp.
    """
    all_steps = task.steps if steps is None else steps
    planned = [step for step in all_steps if step.phase not in _BY_FORCE]
    for step in planned:
        check_name("phase", step.phase, PHASES)
        for name in step.objects:
            check_name("object", name, task.objects)
    labels = _Labels()
    stages: list[Stage] = []
    for run, group in itertools.groupby(planned, _run_of):
        if run.carrying:
            carry = _carry_of(task, trial, run, list(group))
            stages.append(Stage(labels.label("carry", run), carry.offers))
        else:
            for step in group:
                stages.append(_stage_of(task, run, step, labels.label(step.phase, run)))
    chooses_grasps = any(step.grasps for step in planned)
    return Pipeline(task.name, stages, _KEENNESS if chooses_grasps else 0.0)


def _run_of(step: Step) -> _Run:
    return _Run(step.phase in _CARRYING, step.hands, step.objects)


def _carry_of(task: Task, trial: Trial, run: _Run, steps: Sequence[Step]) -> Carry:
    """Return the stage of lift, carry and lower."""
    names = run.objects or (task.carried,)
    rests = any(step.phase == "lower" for step in steps)
    places: list[Place] = []
    for step in steps:
        for T in step.places:
            poses = T if isinstance(T, Mapping) else {names[0]: T}
            rank = len(places)
            places.append(Place(f"place {rank + 1}", poses, _PLACE_COST * rank, rests))
    if not places:
        goals = {name: pose_of(task.objects[name].body, trial.goal[name]) for name in names}
        places = [Place("the goal", goals)]
    limits = task.scene.task
    return Carry(
        places,
        limits.lift_height_m,
        _PLANNED_TILT * limits.tilt_max_rad,
        limits.clear_height_m + _CLEAR_M,
    )


def _stage_of(task: Task, run: _Run, step: Step, label: str) -> Stage:
    """Return the stage of a step that carries nothing."""
    names = run.objects or (task.carried,)
    if step.phase == "insert":
        way = [np.asarray(T) for T in step.places]
        return Stage(label, partial(insert, run.hands, way, *names))
    if step.phase == "approach":
        handled = dict(zip(run.hands, names * len(run.hands), strict=False))
        grips = _grips_of(task, run, step, handled)
        return Stage(label, partial(reach, run.hands, grips, handled))
    return Stage(label, partial(_OF_HANDS[step.phase], run.hands))


def _grips_of(
    task: Task,
    run: _Run,
    step: Step,
    handled: Mapping[str, str],
) -> list[Grip]:
    """Return the grasps of a step, or those of the objects."""
    if step.grasps:
        ways = [{run.hands[0]: T} for T in step.grasps]
    else:
        own = {}
        for hand, name in handled.items():
            grasps = task.objects[name].grasps
            if hand not in grasps:
                existing = ", ".join(grasps)
                raise UsageError(f"the {hand} hand has no grasp of '{name}'; there are {existing}")
            own[hand] = grasps[hand]
        ways = [own]
    return [Grip(f"grasp {k + 1}", way, float(k)) for k, way in enumerate(ways)]


def solve(
    task: Task,
    trial: Trial,
    start: State,
    planner: Planner,
    seed: int = 0,
    apart_m: float | None = None,
    by_force: bool = False,
) -> Solution:
    """Return a plan of the whole task, by the first arrangement of its steps that has one.

    The seven are what, which trial, from where, by what, and three settings with defaults.

    Args:
        task: Objects and steps.
        trial: Its goal.
        start: State before.
        planner: Plans free motions.
        seed: Of the search.
        apart_m: Distance that the arms keep, to which a margin is added; None keeps the planner's.
        by_force: Whether held objects may touch something under impedance.

    Raises:
        TaskFailedError: Of the last arrangement.
    """
    tools = _tools(task, planner, seed, apart_m, by_force=by_force)
    if task.arrange is None:
        arrangements = [task.steps]
    else:
        arrangements = task.arrange(task, trial, start.objects)
    *others, last = (pipeline_of(task, trial, steps) for steps in arrangements)
    for pipeline in others:
        with suppress(TaskFailedError):
            return pipeline.solve(start, tools)
    return last.solve(start, tools)


def _tools(
    task: Task,
    planner: Planner,
    seed: int,
    apart_m: float | None,
    *,
    by_force: bool,
) -> Tools:
    bodies = [item.body for item in task.objects.values()]
    gap = None
    if apart_m is not None:
        reach_m = Reach(planner.kinematics).m
        gap = Gap(arm_distance(planner.robot), reach_m, apart_m + _GAP_MARGIN_M)
    narrowest_m = min(body.half_width_m for body in bodies)
    room_m = planner.robot.hand.travel_m - narrowest_m
    return Tools(
        around=around(task.scene, planner.robot),
        things={body.name: thing_of(body) for body in bodies},
        planner=planner,
        seed=seed,
        gap=gap,
        by_force=by_force,
        fingers_s=room_m / task.config.arbiter.finger_speed_m_per_s,
    )
