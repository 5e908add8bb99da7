"""Joints whose readings fail in a stop: they coast briefly, and the brakes hold them."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from minidual.control import measurement
from minidual.control.joint_check import BLIND_S
from minidual.control.stack import ControlStack
from minidual.errors import UsageError
from minidual.robot.pair import Array
from tests.support.panda import DOF, HOME
from tests.support.stacks import Arms, hand_over, move, run, supervised, trajectory

FROZEN = {
    "one joint": np.arange(DOF) == 1,
    "an elbow and a wrist": np.isin(np.arange(DOF), [3, 12]),
    "the left arm": np.arange(DOF) < 7,
    "both arms": np.ones(DOF, dtype=bool),
}


def in_motion(plant: Arms, ticks: int) -> ControlStack:
    """Return a stack whose arms move at about 1 rad/s."""
    stack = supervised(plant)
    hand_over(stack, "moveit")
    motion = move(HOME, HOME + 0.5 * np.sign(-HOME), 0.8)
    assert stack.propose("moveit", trajectory(stack, motion)) is None
    for _ in range(ticks):
        stack.step()
    assert np.abs(plant.v).max() > 0.8
    return stack


def freeze(plant: Arms, joints: Array, *, velocities: str) -> None:
    """Let readings of some joints stay as they are now; velocities "zero" or "kept"."""
    q = plant.q.copy()
    v = plant.v.copy() if velocities == "kept" else np.zeros(DOF)
    plant.lies["q"] = lambda true: np.where(joints, q, true)
    plant.lies["v"] = lambda true: np.where(joints, v, true)


@pytest.mark.parametrize(("velocities", "pressed"), [("zero", True), ("kept", False)])
@pytest.mark.parametrize("joints", FROZEN)
def test_joints_that_freeze_in_motion_come_to_rest_nearby(
    scene: SceneConfig,
    joints: str,
    velocities: str,
    pressed: bool,
) -> None:
    """At the moment of an emergency stop or without one; truth is read past the frozen encoders."""
    plant = Arms(scene)
    stack = in_motion(plant, 350)
    began = plant.q.copy()
    speed = float(np.abs(plant.v).max())
    freeze(plant, FROZEN[joints], velocities=velocities)
    if pressed:
        stack.supervisor.estop()
    fastest = 0.0
    farthest = 0.0
    for _ in range(2000):
        run(stack, 1)
        fastest = max(fastest, float(np.abs(plant.true_v).max()))
        farthest = max(farthest, float(np.abs(plant.true_q - began).max()))
    assert stack.reflex is not None
    assert np.abs(plant.true_v).max() < 0.05
    assert fastest < speed + 0.5
    assert farthest < 0.25


def test_without_brakes_frozen_joints_would_drift(
    scene: SceneConfig,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Negative control of the brakes."""
    monkeypatch.setattr(measurement.Reader, "braking_due", property(lambda reader: False))
    plant = Arms(scene)
    stack = in_motion(plant, 350)
    began = plant.q.copy()
    freeze(plant, FROZEN["both arms"], velocities="zero")
    stack.supervisor.estop()
    run(stack, 3000)
    assert np.abs(plant.true_q - began).max() > 0.25


def test_readings_that_return_in_a_stop_are_not_used_before_a_recovery(scene: SceneConfig) -> None:
    plant = Arms(scene)
    stack = in_motion(plant, 350)
    freeze(plant, FROZEN["one joint"], velocities="kept")
    run(stack, 200)
    assert stack.reflex is not None
    assert stack.reflex.reflex.label == "measurement.implausible"
    plant.lies.clear()
    run(stack, 10)
    assert stack.measurement.blind[1]
    run(stack, 600)
    stack.recover()
    assert not stack.measurement.blind.any()
    assert not plant.braked.any()
    assert run(stack, 200) == []


def test_a_recovery_that_is_refused_trusts_no_blind_joint(scene: SceneConfig) -> None:
    plant = Arms(scene)
    stack = in_motion(plant, 350)
    freeze(plant, FROZEN["one joint"], velocities="kept")
    run(stack, 20)
    assert stack.measurement.blind[1]
    plant.lies.clear()
    with pytest.raises(UsageError, match="while they move"):
        stack.recover()
    run(stack, 1)
    assert stack.measurement.blind[1]


def test_arms_without_new_readings_stop_and_are_braked(scene: SceneConfig) -> None:
    plant = Arms(scene)
    stack = in_motion(plant, 350)
    began_s = plant.time
    plant.lies["stamp_s"] = lambda stamp_s: began_s
    assert run(stack, 1000) == ["measurement.stale"]
    assert plant.braked.all()
    assert np.abs(plant.v).max() < 0.05
    with pytest.raises(UsageError, match="old"):
        stack.recover()


def test_an_ill_plant_is_named_and_not_recovered(scene: SceneConfig) -> None:
    plant = Arms(scene)
    stack = in_motion(plant, 350)
    plant.health = "joint 4: drive over temperature"
    assert run(stack, 800) == ["plant_failed"]
    assert stack.reflex is not None
    assert "drive over temperature" in stack.reflex.message
    with pytest.raises(UsageError, match="over temperature"):
        stack.recover()
    plant.health = ""
    stack.recover()
    assert run(stack, 200) == []


def test_a_joint_coasts_no_longer_than_the_bound(scene: SceneConfig) -> None:
    plant = Arms(scene)
    stack = in_motion(plant, 350)
    freeze(plant, FROZEN["one joint"], velocities="kept")
    ticks = 0
    while not plant.braked.any():
        run(stack, 1)
        ticks += stack.measurement.blind.any()
        assert ticks < 200
    assert ticks * plant.dt < BLIND_S + 0.003
