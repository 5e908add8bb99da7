"""A plant that takes joint targets gets the reference, the reference of a stop, and no impedance law."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.config.scene import SceneConfig
from minidual.control.commands import JointCommand
from minidual.control.controller_manager import ControllerSwitchError
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.plant.lifecycle import Connection
from minidual.plant.simulated import PositionWorld
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.skills.plant_drive import DriveError, PlantDrive
from tests.support.panda import HOME
from tests.support.position_plant import Follower

DUAL_V_MAX = 2.61


def stack_of(plant: object) -> ControlStack:
    supervisor = Supervisor(dt_s=plant.dt, kinematics=Kinematics())
    return ControlStack(plant, Kinematics(), supervisor=supervisor)


def drive(stack: ControlStack, target: np.ndarray, seconds: float) -> None:
    stack.request("teleop")
    end_s = stack.plant.time + seconds
    sequence = 0
    while stack.plant.time < end_s:
        if stack.tick_next and stack.source == "teleop":
            sequence += 1
            command = JointCommand(target, np.ones(2), stack.plant.time, sequence)
            stack.propose("teleop", command)
        stack.step()


def test_joint_targets_reach_the_plant_without_a_jump() -> None:
    plant = Follower()
    target = HOME.copy()
    target[3] += 0.03
    drive(stack_of(plant), target, 1.5)
    assert abs(plant.q[3] - target[3]) < 1e-3
    sent = np.array(plant.targets)
    assert np.abs(np.diff(sent, axis=0)).max() < 0.02 * DUAL_V_MAX


def test_impedance_laws_are_refused_by_name() -> None:
    stack = stack_of(Follower())
    for name in (["object_impedance"], ["left_hand", "right_arm"]):
        with pytest.raises(ControllerSwitchError, match=r"wrong_plant: .*joint targets") as error:
            stack.request("moveit", name)
        assert "takes torques" in (error.value.remedy or "")


def test_a_plant_that_reports_a_fault_stops_both_arms_by_name() -> None:
    plant = Follower()
    stack = stack_of(plant)
    target = HOME + 0.02
    drive(stack, target, 0.5)
    plant.faults = [(), ("cartesian_reflex",)]
    with pytest.raises(ReflexError, match=r"plant_failed.*cartesian_reflex"):
        stack.step()
    after = len(plant.targets)
    for _ in range(50):
        stack.step()
    last = np.array(plant.targets[after:])
    assert np.abs(last[-1] - last[-5]).max() < 1e-6  # both arms stand
    assert np.abs(last[0] - plant.targets[after - 1]).max() < 0.02 * DUAL_V_MAX


def test_the_emergency_stop_brakes_along_the_reference_of_the_stop() -> None:
    plant = Follower()
    link = Connection("mine:Follower", plant).open()
    one = PlantDrive(link, Config())
    one.begin()
    ramp = HOME + np.linspace(0.0, 0.06, 20)[:, None]
    one.follow(ramp)
    rest_s = one.stop_and_rest("test")
    assert 0.0 < rest_s < 0.5
    assert one.stack.reflex is not None
    one.recover()
    log = one.move(HOME, seconds=0.2)
    assert np.abs(log.q[-1] - HOME).max() < 1e-3


def test_arms_that_are_not_given_are_a_named_failure() -> None:
    plant = Follower()
    one = PlantDrive(Connection("mine:Follower", plant).open(), Config())
    one.stack.request = lambda *arguments: None
    with pytest.raises(DriveError, match="the arms were not given"):
        one.begin()


def test_the_simulated_position_plant_follows_targets() -> None:
    plant = PositionWorld(World(SceneConfig()), 50.0)
    one = PlantDrive(Connection("sim-position", plant).open(), Config())
    one.begin()
    goal = HOME.copy()
    goal[[1, 8]] -= 0.1
    log = one.move(goal, seconds=0.4)
    assert np.abs(log.q[-1] - goal).max() < 0.005
    assert log.rms_rad < 0.05
    assert plant.sent.q is not None
    with suppress(ReflexError):
        one.stack.step()
    assert one.stack.reflex is None
