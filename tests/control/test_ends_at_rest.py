"""Loops above the stack end with arms at rest: drives, demonstrations of the modes, teleoperated episodes."""

from __future__ import annotations

import dataclasses
from collections.abc import Generator
from typing import Any

import numpy as np
import pytest

from minidual.config.learning import TeleopConfig
from minidual.config.scene import SceneConfig
from minidual.control.controller_manager import ControllerSwitchError
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.demos.leader import LeaderSample
from minidual.demos.leaders.scripted import ScriptedLeader
from minidual.demos.session import TeleopSession, Tick
from minidual.demos.station import Button
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.skills.operator import ScriptedOperator
from minidual.skills.pipeline.drive import Drive
from minidual.skills.states import Segment, still
from minidual.trials.modes import ModesDemo
from minidual.trials.modes_turns import SwitchError, Turn
from tests.support.carry_trials import carry_task, sample_trial
from tests.support.panda import HOME
from tests.support.stacks import (
    APART,
    Arms,
    hand_over,
    move,
    nan_of,
    run,
    supervised,
    trajectory,
)


@pytest.fixture
def plant(scene: SceneConfig) -> Arms:
    return Arms(scene)


def standing(*names: str) -> list[Segment]:
    return [still(name, HOME, 0.2, (1.0, 1.0)) for name in names]


def step_to_end(drive: Drive, ticks: int = 2000) -> None:
    for _ in range(ticks):
        drive.step()
        if drive.done:
            return
    raise AssertionError("the drive does not end")


# Drives -----------------------------------------------------------------------------------------------------


def test_a_source_that_does_not_drive_holds_nobody_up(plant: Arms) -> None:
    stack = supervised(plant)
    drive = Drive(stack, standing("a", "b"))
    sequence = 0
    while not drive.done and plant.time < 2.0:
        sequence += 1
        command = trajectory(stack, move(HOME, HOME + 0.1, 1.0), sequence)
        assert stack.propose("policy", command) is None
        drive.step()
    assert drive.aborted is None
    assert plant.time < 0.5


def test_an_error_between_two_segments_is_a_reflex_in_the_same_tick(
    plant: Arms,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stack = supervised(plant)
    drive = Drive(stack, standing("a", "b"))

    def take_control(segment: Segment) -> None:
        if segment.phase == "b":
            raise ControllerSwitchError("not_ready", "the hand is not there")

    monkeypatch.setattr(drive, "_take_control", take_control)
    ticks = 0
    while not drive.done:
        drive.step()
        ticks += 1
    assert len(plant.torques) == ticks
    assert drive.aborted is not None
    assert drive.aborted.startswith("phase 'b': ")
    assert "the hand is not there" in drive.aborted


def test_an_earlier_refusal_does_not_end_the_next_drive(plant: Arms) -> None:
    stack = supervised(plant)
    hand_over(stack, "moveit")
    command = trajectory(stack, move(HOME, HOME, 0.2))
    stack.propose("moveit", dataclasses.replace(command, stamp_s=-1.0))
    run(stack, 40)
    assert [r.source for r in stack.refusals] == ["moveit"]
    stack.request("hold")
    run(stack, 200)
    drive = Drive(stack, standing("a"))
    step_to_end(drive)
    assert drive.aborted is None


def test_a_drive_that_is_never_handed_the_arms_ends(plant: Arms) -> None:
    stack = supervised(plant)
    drive = Drive(stack, standing("a"))
    stack.request("hold")
    step_to_end(drive, 300)
    assert drive.aborted is not None
    assert "not handed over" in drive.aborted


@pytest.mark.parametrize("by", ["hold", "policy"])
def test_a_drive_that_somebody_ends_is_done_when_the_arms_rest(plant: Arms, by: str) -> None:
    stack = supervised(plant)
    drive = Drive(stack, [Segment("approach", move(HOME, HOME + APART, 1.0), (1.0, 1.0), None)])
    for _ in range(500):
        drive.step()
    assert np.abs(plant.v).max() > 0.8
    stack.request(by)
    step_to_end(drive)
    assert drive.aborted is not None
    assert np.abs(plant.v).max() < 0.06


# Demonstrations and episodes --------------------------------------------------------------------------------


@pytest.mark.parametrize("error", [SwitchError("refused"), ValueError("a planner broke")])
@pytest.mark.parametrize("blind", [False, True])
def test_a_demonstration_of_modes_ends_with_arms_at_rest(
    plant: Any,
    error: Exception,
    blind: bool,
) -> None:
    stack = ControlStack(plant, Kinematics(), supervisor=Supervisor(dt_s=plant.dt))

    def drive() -> Generator[None]:
        stack.propose("moveit", trajectory(stack, move(HOME, HOME + APART, 1.0)))
        for _ in range(500):
            stack.affirm("moveit")
            yield
        if blind:
            plant.lies.update(q=nan_of(3), v=nan_of(3))
        raise error

    demo = ModesDemo(stack, [Turn("moveit", "", drive)])
    raised: list[str] = []
    try:
        for _ in demo.steps():
            pass
    except ValueError as caught:
        raised.append(str(caught))
    assert raised == ([] if isinstance(error, SwitchError) else ["a planner broke"])
    assert demo.ended == str(error)
    assert np.abs(plant.true_v).max() < 0.05
    assert (stack.reflex is not None) is blind


def session_of(world: World) -> tuple[ControlStack, TeleopSession]:
    config = TeleopConfig()
    supervisor = Supervisor(dt_s=world.dt)
    stack = ControlStack(world, Kinematics(), rate_hz=config.rate_hz, supervisor=supervisor)
    return stack, TeleopSession(stack, config)


def test_a_halt_in_a_teleoperated_episode_ends_it_as_stopped(scene: SceneConfig) -> None:
    world = World(scene)
    stack, session = session_of(world)
    trial = sample_trial(scene, 7, "demonstrations", 0, widen=1.3)
    speeds: list[float] = []

    def on_tick(_: Tick) -> None:
        speeds.append(float(np.abs(world.v).max()))
        if len(speeds) == 60:
            stack.halt("teleop")

    leader = ScriptedLeader(ScriptedOperator(scene).plan(trial, seed=7))
    result = session.run(carry_task(scene), trial, leader, on_tick=on_tick)
    assert speeds[59] > 0.8
    assert result.ended_by == "stopped"
    assert stack.reflex is None
    assert np.abs(world.v).max() < 0.05


class Hasty(ScriptedLeader):
    """Ends as soon as its arms move fast."""

    world: World

    def read(self, now_s: float) -> LeaderSample | None:
        sample = super().read(now_s)
        is_fast = float(np.abs(self.world.v).max()) > 0.8
        if sample is None or not is_fast:
            return sample
        return dataclasses.replace(sample, pressed=(Button.SUCCESS,))


def test_an_episode_that_its_leader_ends_in_motion_ends_at_rest(world: World) -> None:
    scene = world.scene
    _, session = session_of(world)
    trial = sample_trial(scene, 7, "test", 0)
    leader = Hasty(ScriptedOperator(scene).plan(trial, seed=7))
    leader.world = world
    result = session.run(carry_task(scene), trial, leader)
    assert result.ended_by == "leader"
    assert not result.success
    assert np.abs(world.v).max() < 0.05
