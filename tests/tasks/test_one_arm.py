"""One arm alone fails every task that is made for two, though it tries all it can.

The other arm stands at home with open fingers, and nothing is scripted at it: MuJoCo computes its
contacts as it does those of the free arm. The free arm has the whole planner: it chooses among
grasps and ways of the task's pipeline, knows the true poses, and drives what it plans. An object
that it cannot grasp or bring to its goal by any of them is one draw in which it fails.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.control.stack import ControlStack
from minidual.motion.api import Planner
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array, pose, rot_z
from minidual.skills.planned_carry import PlannedCarry
from minidual.tasks.catalogue import make_task
from minidual.tasks.judge import Outcome, begin
from minidual.tasks.task import DOWN, Step, Task, Trial, placement
from tests.support.carries import true_poses

_TURNS = (0.0, np.pi / 2.0, -np.pi / 2.0, np.pi)
_FROM_THE_SIDE = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
_PHASES = ("descend", "close", "lift", "carry", "lower", "open", "retreat")


@cache
def task_named(name: str) -> Task:
    return make_task(Config(task=name))


def rod_grasps() -> tuple[Array, ...]:
    """The middle first: there it hangs level."""
    along_m = (0.0, 0.05, -0.05, 0.12, -0.12)
    z = task_named("rod_carry").scene.object.grasp_height_m
    return tuple(pose(rot_z(turn) @ DOWN, (0.0, y, z)) for y in along_m for turn in (0.0, np.pi))


def pot_grasps() -> tuple[Array, ...]:
    """The knob of the lid, by which the pot hangs level, then each handle."""
    knob = tuple(pose(rot_z(turn) @ DOWN, (0.0, 0.0, 0.068)) for turn in _TURNS)
    handles = tuple(pose(DOWN, (0.0, y, 0.03)) for y in (0.13, -0.13))
    return (*knob, *handles)


def bottle_grasps() -> tuple[Array, ...]:
    """From above, and from the side at three heights."""
    above = tuple(pose(rot_z(turn) @ DOWN, (0.0, 0.0, z)) for z in (0.07, 0.085) for turn in _TURNS)
    beside = tuple(
        pose(rot_z(turn) @ _FROM_THE_SIDE, (0.0, 0.0, z)) for z in (0.0, 0.05) for turn in _TURNS
    )
    return (*above, *beside)


GRASPS: dict[str, Callable[[], tuple[Array, ...]]] = {
    "rod_carry": rod_grasps,
    "pot_lift": pot_grasps,
    "handover": bottle_grasps,
}
TWO_ARMED = {"rod_carry": {"held"}, "pot_lift": {"held"}, "handover": {"exchanged"}}
"""Conditions that ask for two arms."""


def places_of(task: Task, trial: Trial, arm: str) -> tuple[Array, ...]:
    """Return the goal, then poses as near to the free arm as the task tolerates."""
    x, y, yaw = placement(trial.goal[task.carried])
    nearer_m = 0.9 * task.scene.task.goal_tolerance_m * (1.0 if arm == SIDES[0] else -1.0)
    height_m = task.scene.object.rest_height_m
    turns = _TURNS if task.name == "handover" else (0.0, np.pi)
    return tuple(
        pose(rot_z(yaw + turn), (x, y + shift_m, height_m))
        for shift_m in (0.0, nearer_m)
        for turn in turns
    )


def alone(task: Task, trial: Trial, arm: str) -> Task:
    """Return the task as one arm does it: all of its steps, with the arm's grasps and places."""
    approach = Step("approach", (arm,), grasps=GRASPS[task.name]())
    steps = [approach]
    for phase in _PHASES:
        places = places_of(task, trial, arm) if phase == "carry" else ()
        steps.append(Step(phase, (arm,), places=places))
    return dataclasses.replace(task, steps=tuple(steps), arrange=None)


def tried(name: str, index: int, planner: Planner) -> Outcome | None:
    """Return what one arm achieves in a draw; None if it finds no plan."""
    task = task_named(name)
    trial = task.trial(3, "frozen", index)
    arm = SIDES[index % 2]
    world = World(task.scene)
    judge = begin(world, task, trial)
    stack = ControlStack(world, Kinematics())
    drive = PlannedCarry(
        stack, planner, alone(task, trial, arm), trial, index, poses=true_poses(world, task)
    )
    if drive.solution is None:
        return None
    while not drive.done and world.time < task.time_limit_s:
        drive.step()
        judge.observe(world)
    return judge.outcome(world)


def refusals(name: str, draws: range) -> Counter[str]:
    """Return how one arm ended in these draws, after checking that it never succeeded.

    "two arms alone" counts the draws in which it met every condition that one arm can meet.
    """
    planner = Planner()
    ends = Counter[str]()
    for index in draws:
        outcome = tried(name, index, planner)
        if outcome is None:
            ends["no plan"] += 1
            continue
        assert not outcome.success
        names = {failure.name for failure in outcome.failures}
        ends["two arms alone" if names <= TWO_ARMED[name] else "also others"] += 1
    return ends


@pytest.mark.parametrize("name", GRASPS)
def test_one_arm_fails_a_draw(name: str) -> None:
    ends = refusals(name, range(2))
    assert ends.total() == 2


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("name", GRASPS)
def test_one_arm_fails_every_draw_of_256(name: str) -> None:
    """It does all that one arm can do in some of them: there the two-arm condition alone says no."""
    ends = refusals(name, range(256))
    assert ends.total() == 256
    assert ends["two arms alone"] > 0, ends
