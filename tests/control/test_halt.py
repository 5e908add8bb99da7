"""A halt stops the arms where they are, in the next step, whatever is under way."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from minidual.control.commands import ArbiterState, JointCommand, ObjectCommand
from minidual.control.controller_manager import ControllerSwitchError
from minidual.control.stack import DEFAULT_CONTROLLERS, OBJECT_CONTROLLERS
from minidual.errors import UsageError
from minidual.robot.pair import Array
from minidual.skills.object_path import ObjectPath, Waypoint
from tests.support.control_plant import HandsObject
from tests.support.panda import A_MAX, HOME
from tests.support.stacks import (
    CLOSED,
    OPEN,
    Arms,
    breaks,
    hand_over,
    in_motion,
    move,
    run,
    stack_on,
    supervised,
    trajectory,
    under_way,
)

STOPPING = ("soft_stop",)


@pytest.fixture
def plant(scene: SceneConfig) -> Arms:
    return Arms(scene)


def test_a_halt_acts_in_the_next_step_and_brings_the_arms_to_rest(plant: Arms) -> None:
    stack = under_way(plant)
    speeds = [plant.v.copy()]
    torques = [plant.torques[-1]]
    stack.halt("moveit")
    run(stack, 1)
    assert stack.output.halted
    assert stack.manager.active == STOPPING
    assert (stack.state, stack.source, stack.executing) == (ArbiterState.STOPPED, None, False)
    speeds.append(plant.v.copy())
    for _ in range(500):
        assert run(stack, 1) == []
        speeds.append(plant.v.copy())
    assert not stack.output.halted, "once"
    assert np.abs(plant.v).max() < 1e-3
    torques += plant.torques[-501:]
    assert np.abs(np.diff(torques, axis=0)).max() < 1.5, "a jolt"
    slower = (np.abs(speeds[:-20]) - np.abs(speeds[20:])).max(axis=0) / 0.02 / A_MAX
    assert slower.max() < 0.7, "65 % of the limits, and how the arms follow it"
    assert slower.max() > 0.3, "a stop, not a drift"
    np.testing.assert_array_equal(stack.output.gripper, CLOSED, "the hands let go")


@pytest.mark.parametrize(("who", "opens"), [("moveit", True), ("teleop", False)])
def test_everybody_may_halt_and_only_who_drives_may_open_the_hands(
    plant: Arms,
    who: str,
    opens: bool,
) -> None:
    stack = under_way(plant)
    stack.halt(who, np.ones(2))
    run(stack, 1)
    assert stack.manager.active == STOPPING
    np.testing.assert_array_equal(stack.output.gripper, np.full(2, float(opens)))
    refused = [(r.source, r.name) for r in stack.refusals]
    assert refused == ([] if opens else [(who, "not_driving")])


def test_openings_that_are_not_finite_are_refused_and_the_arms_stop_all_the_same(
    plant: Arms,
) -> None:
    stack = under_way(plant)
    stack.halt("moveit", np.array([0.5, np.nan]))
    run(stack, 1)
    assert stack.manager.active == STOPPING
    assert [r.name for r in stack.refusals] == ["not_finite"]
    np.testing.assert_array_equal(stack.output.gripper, CLOSED)
    with pytest.raises(UsageError, match="no command source 'somebody'"):
        stack.halt("somebody")


def test_a_halted_object_path_pushes_the_hands_no_more(plant: Arms) -> None:
    here = HandsObject(plant)
    stack = stack_on(plant, sensor=here)
    weightless = dataclasses.replace(here.held(), mass_kg=1e-6)
    stack.impedance.configure(weightless)
    hand_over(stack, "moveit", OBJECT_CONTROLLERS)
    x, y, z = here.pose()[:3, 3].tolist()
    path = ObjectPath(Waypoint((x, y, z), 0.0, 0.0), [Waypoint((x, y, z + 0.1), 0.0, 0.8)])
    command = ObjectCommand(path, lambda t: 0.0, CLOSED, plant.time, 1)
    assert stack.propose("moveit", command) is None
    run(stack, 300)
    assert np.abs(plant.v).max() > 0.1
    stack.halt("moveit")
    run(stack, 500)
    assert stack.manager.active == STOPPING
    assert np.abs(plant.v).max() < 1e-3


@pytest.mark.parametrize("settling", [False, True])
def test_a_switch_that_waits_is_refused_by_a_halt_and_may_be_requested_again(
    plant: Arms,
    settling: bool,
) -> None:
    stack = under_way(plant)
    stack.request("teleop")
    if settling:
        run(stack, 1)
        assert stack.state is ArbiterState.SETTLING
    stack.halt("moveit")
    run(stack, 1)
    assert [(r.source, r.name) for r in stack.refusals] == [("teleop", "superseded")]
    run(stack, 400)
    assert stack.source is None
    reason = stack.manager.refuses(JointCommand(HOME, CLOSED, plant.time, 9))
    assert reason is not None
    assert reason[0] == "wrong_controller"
    hand_over(stack, "teleop")
    assert stack.manager.active == DEFAULT_CONTROLLERS
    assert stack.propose("teleop", JointCommand(plant.q + 0.05, CLOSED, plant.time, 10)) is None
    assert run(stack, 30) == []
    assert stack.output.active_source == "teleop"


def test_a_hold_requested_with_a_halt_leaves_the_stop_in_charge(plant: Arms) -> None:
    stack = under_way(plant)
    stack.halt("moveit")
    stack.request("hold")
    run(stack, 700)
    assert stack.state is ArbiterState.HOLDING
    assert stack.manager.active == STOPPING
    assert np.abs(plant.v).max() < 1e-3


def test_controllers_do_not_change_while_a_halt_brakes_and_move_nothing_afterwards(
    plant: Arms,
) -> None:
    stack = in_motion(plant)
    stack.halt("teleop")
    assert run(stack, 20) == []
    with pytest.raises(ControllerSwitchError, match="are being stopped"):
        stack.switch_controllers(DEFAULT_CONTROLLERS)
    run(stack, 800)
    assert not stack.stopping
    rest = plant.q.copy()
    stack.switch_controllers(DEFAULT_CONTROLLERS)
    run(stack, 500)
    assert np.abs(plant.q - rest).max() < 1e-3


def test_who_drives_after_a_halt_may_change_the_controllers(plant: Arms) -> None:
    stack = in_motion(plant)
    stack.halt("teleop")
    run(stack, 400)
    hand_over(stack, "teleop")
    assert stack.propose("teleop", JointCommand(plant.q + 0.09, OPEN, plant.time, 1)) is None
    run(stack, 60)
    assert np.abs(plant.v).max() > 0.05
    stack.switch_controllers(("left_arm", "right_arm"))


@pytest.mark.parametrize("gripper", [OPEN, CLOSED], ids=["open", "closed"])
def test_a_halt_brakes_each_arm_in_its_own_time_unless_both_hands_are_closed(
    plant: Arms,
    gripper: Array,
) -> None:
    stack = supervised(plant)
    hand_over(stack, "teleop")
    target = HOME.copy()
    sequence = 0
    for _ in range(400):
        if stack.tick_next:
            target[0] += 0.03
            target[7] += 0.008
            sequence += 1
            command = JointCommand(target, gripper, plant.time, sequence)
            assert stack.propose("teleop", command) is None
        assert run(stack, 1) == []
    fast, slow = np.abs(plant.v)[[0, 7]].tolist()
    assert fast > 1.2
    assert 0.3 < slow < 0.5
    began = plant.q
    stack.halt("teleop")
    assert run(stack, 1500) == []
    way = np.abs(plant.q - began)[[0, 7]]
    assert np.abs(plant.v).max() < 0.01
    if gripper is CLOSED:  # they may hold one object: one profile, ways as the speeds
        assert way[0] / way[1] == pytest.approx(fast / slow, rel=0.15)
        assert way[1] > 0.04
    else:
        assert way[1] < 0.03


@pytest.mark.parametrize("rate_hz", [50.0, 10.0])
def test_a_halt_from_a_flush_listener_acts_in_the_next_step(plant: Arms, rate_hz: float) -> None:
    stack = supervised(plant, rate_hz=rate_hz)
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.3, 0.9))) is None
    run(stack, 430)
    halted_at: list[int] = []

    def listener(mode: str) -> None:
        if not halted_at:
            halted_at.append(plant.steps)
            stack.halt("teleop")

    stack.on_flush(listener)
    stack.request("teleop")
    while not stack.output.halted and plant.steps < 2000:
        run(stack, 1)
    assert plant.steps - halted_at[0] <= 2


def test_a_listener_that_fails_loses_no_halt(plant: Arms) -> None:
    stack = in_motion(plant)
    began = plant.q.copy()
    stack.on_flush(breaks)
    stack.halt("teleop")
    assert run(stack, 800) == ["controller_failed"]
    assert stack.source is None
    assert np.abs(plant.q - began).max() < 0.12
    assert np.abs(plant.v).max() < 0.01
