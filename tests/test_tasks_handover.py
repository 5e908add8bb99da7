"""A bottle changes hands in the air: a task of the table, solved by the pipeline and judged by its own conditions."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.control.stack import ControlStack
from minidual.errors import UsageError
from minidual.motion.api import Planner
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.skills.cycle import pipeline_of, thing_of
from minidual.skills.pipeline.drive import Drive
from minidual.skills.planned_carry import PlannedCarry
from minidual.skills.supervised import trial_supervisor
from minidual.tasks.judge import Outcome, begin
from minidual.tasks.task import Step, Task, make_task

TASK = make_task(Config(task="handover"))


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner()


@pytest.fixture(scope="module")
def bench() -> World:
    return World(TASK.scene)


def run(world: World, planner: Planner, seed: int) -> tuple[Outcome, PlannedCarry]:
    trial = TASK.trial(seed, "plan", 0)
    judge = begin(world, TASK, trial)
    shape = thing_of(TASK.objects[TASK.carried].body).shape
    supervisor = trial_supervisor(TASK.config.supervisor, world.dt, world.robot, shape=shape)
    carry = PlannedCarry(ControlStack(world, Kinematics(), supervisor=supervisor), planner, TASK, trial, seed)
    return drive(world, judge, carry), carry


def drive(world: World, judge, method: Drive) -> Outcome:
    while not method.done and world.time < TASK.time_limit_s:
        method.step()
        judge.observe(world)
    return judge.outcome(world)


def test_the_bottle_changes_hands_in_the_air_and_stands_at_its_goal(bench: World, planner: Planner) -> None:
    outcome, carry = run(bench, planner, 1)
    assert outcome.success, (outcome.reason, carry.aborted)
    assert outcome.measured["goal_error_m"] < 0.02
    names = [stage.name for stage in carry.solution.record.stages]
    assert names[3:8] == ["carry left", "approach right", "descend right", "close right", "open left"]

    # Negative control: the same plan without the second hand's closing drops the bottle, and the judge says so.
    judge = begin(bench, TASK, TASK.trial(1, "plan", 0))
    open_right = [
        dataclasses.replace(segment, openings=(segment.openings[0], 1.0)) for segment in carry.solution.segments
    ]
    outcome = drive(bench, judge, Drive(ControlStack(bench, Kinematics()), open_right))
    assert not outcome.success
    assert {"held", "exchanged"} <= {fault.name for fault in outcome.failures}


@pytest.mark.slow
def test_it_succeeds_from_other_starts(bench: World, planner: Planner) -> None:
    outcomes = [run(bench, planner, seed)[0] for seed in (2, 3, 4, 5, 6)]
    assert [o.success for o in outcomes] == [True] * 5, [o.reason for o in outcomes]


def test_each_end_is_out_of_the_other_hand_s_reach(planner: Planner) -> None:
    """Why it takes two hands: neither alone can plan the whole."""
    for hand in ("left", "right"):
        phases = ("approach", "descend", "close", "lift", "carry", "lower", "open")
        alone = dataclasses.replace(TASK, steps=tuple(Step(phase, (hand,)) for phase in phases))
        trial = TASK.trial(1, "plan", 0)
        carry = PlannedCarry(ControlStack(World(TASK.scene), Kinematics()), planner, alone, trial, 1)
        assert carry.solution is None
        assert "cannot reach" in (carry.aborted or "")


def test_a_step_that_cannot_be_planned_is_refused_by_name() -> None:
    def with_steps(*steps: Step) -> Task:
        return dataclasses.replace(TASK, steps=steps)

    trial = TASK.trial(1, "plan", 0)
    with pytest.raises(UsageError, match=r"no phase 'aproach'.*approach"):
        pipeline_of(with_steps(Step("aproach", ("left",))), trial)
    with pytest.raises(UsageError, match=r"no object 'cup'.*bottle"):
        pipeline_of(with_steps(Step("close", ("left",), ("cup",))), trial)
    bare = dataclasses.replace(TASK.objects["bottle"], grasps={"left": np.eye(4)})
    no_right = dataclasses.replace(TASK, objects={"bottle": bare})
    with pytest.raises(UsageError, match="the right hand has no grasp of 'bottle'; there are left"):
        pipeline_of(no_right, trial)
