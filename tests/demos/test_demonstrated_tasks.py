"""Demonstrations of every task: the scripted operator acts through the task, and a trial without a plan is set aside."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.cli.app import run_command_line
from minidual.config.root import Config, changed
from minidual.demos.leader import LEADERS, LeaderSetup
from minidual.demos.leaders.scripted import ScriptedLeader, plan_demonstration
from minidual.demos.rig import Job, Rig
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, SIDES
from minidual.skills.operator import Demonstration, ScriptedOperator
from minidual.skills.pipeline.record import Record
from minidual.skills.pipeline.search import TaskFailedError
from minidual.stages.registry import STAGES, TOOLS
from minidual.tasks.catalogue import TASKS, make_task
from minidual.tasks.task import Step, Task, Trial
from tests.support.panda import HOME, Q_LOWER, Q_UPPER, V_MAX
from tests.support.recording_toys import ToyRig, job

SEED = 5


def demonstrated(task: Task, trial: Trial) -> Demonstration:
    return plan_demonstration(LeaderSetup(DUAL_PANDA, task, task.config.teleop, SEED), trial)


@functools.cache
def inserted_peg() -> tuple[Task, Trial, Demonstration]:
    task = make_task(Config(task="insertion"))
    trial = task.trial(SEED, "demonstrations", 0)
    return task, trial, demonstrated(task, trial)


def test_tasks_of_two_hands_on_one_object_are_demonstrated_by_phases() -> None:
    assert {name for name in TASKS if make_task(Config(task=name)).together} == {
        "rod_carry",
        "pot_lift",
    }
    task = make_task(Config())
    trial = task.trial(SEED, "demonstrations", 0)
    operator = ScriptedOperator(
        task.scene,
        task.config.teleop.operator,
        kinematics=Kinematics(DUAL_PANDA),
    )
    plain = operator.plan(trial, seed=SEED)
    demo = demonstrated(task, trial)
    np.testing.assert_array_equal(demo.q, plain.q)
    np.testing.assert_array_equal(demo.gripper, plain.gripper)
    one_each = dataclasses.replace(task, steps=(Step("approach", SIDES, ("rod", "peg")),))
    assert not one_each.together, "each hand has an object of its own"


def test_a_planned_demonstration_begins_at_home_and_keeps_the_joints_limits() -> None:
    _, _, demo = inserted_peg()
    np.testing.assert_allclose(demo.q[0], HOME, atol=1e-9)
    assert np.all((demo.q > Q_LOWER) & (demo.q < Q_UPPER))
    speed = np.abs(np.diff(demo.q, axis=0)) * demo.rate_hz / V_MAX
    assert 0.3 < speed.max() <= 0.7, (
        "slower than the plan, so that the arms keep up with what is streamed"
    )


def test_a_hand_that_takes_an_object_from_the_other_one_does_not_err() -> None:
    config = Config(task="handover")

    def with_noise(along_m: float) -> Demonstration:
        task = make_task(changed(config, {"teleop.operator.along_noise_m": along_m}))
        return demonstrated(task, task.trial(1, "d", 0))

    exact = with_noise(0.0)
    erring = with_noise(0.03)
    closes = int(np.argmax(exact.gripper.min(axis=1) < 1.0))
    assert 0 < closes < np.argmax(exact.gripper.max(axis=1) < 1.0), (
        "one hand holds before the other one closes"
    )
    assert np.abs(erring.q[:closes] - exact.q[:closes]).max() > 0.01, "it errs until then"
    np.testing.assert_allclose(erring.q[closes:], exact.q[closes:], atol=1e-9)


def test_a_trial_is_planned_alike_every_time() -> None:
    task, trial, demo = inserted_peg()
    np.testing.assert_array_equal(demonstrated(task, trial).q, demo.q)


class Planless(ToyRig):
    """Finds no plan for odd trials."""

    def lead(self, trial: Trial, on_tick: Any) -> Any:
        if trial.index % 2:
            raise TaskFailedError("handover", Record([]))
        return super().lead(trial, on_tick)


def test_a_trial_without_a_plan_is_an_attempt_with_a_reason(tmp_path: Path) -> None:
    rig = Planless(job(tmp_path), ())
    kept = rig.record(0)
    lost = rig.record(1)
    assert kept.kept
    assert (lost.kept, lost.path) == (False, None)
    assert lost.reason == "the task 'handover' failed; no stage stops it alone"
    assert [path.name for path in tmp_path.glob("*/*.hdf5")] == ["episode_000000.hdf5"]
    assert Planless(job(tmp_path), ()).record(1).adopted, (
        "an interrupted recording does not try it again"
    )


@pytest.mark.parametrize("stage", ["teleop-record", "deploy"])
def test_the_option_task_is_that_of_the_configuration(
    stage: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert STAGES[stage].settings["task"] == "task"
    assert (
        run_command_line([stage, "--task", "handovr", "--runs-dir", str(tmp_path)], STAGES, TOOLS)
        == 2
    )
    assert "did you mean 'handover'?" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_every_task_can_be_recorded(name: str, tmp_path: Path) -> None:
    config = make_task(Config(task=name)).config
    rig = Rig(
        Job(tmp_path, make_task(config), config.teleop, config.arbiter, SEED, config.supervisor),
        ("high",),
    )
    attempts = [rig.record(index) for index in range(2)]
    rig.close()
    assert any(attempt.kept for attempt in attempts), [attempt.reason for attempt in attempts]
    assert not any(attempt.faults for attempt in attempts)
    assert LEADERS["scripted"] is ScriptedLeader
