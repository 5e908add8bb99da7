"""Switches of controllers and modes: which set is active when, and that nothing is drawn anywhere by a switch."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from minidual.control.commands import ArbiterState, JointCommand, ObjectCommand
from minidual.control.controller_manager import ControllerSwitchError
from minidual.control.impedance import SingularPostureError
from minidual.control.kernels import minimum_jerk
from minidual.control.stack import DEFAULT_CONTROLLERS, OBJECT_CONTROLLERS
from minidual.errors import UsageError
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.object_path import ObjectPath, Waypoint
from tests.support.control_plant import HandsObject
from tests.support.panda import DOF, HOME
from tests.support.stacks import (
    CLOSED,
    OPEN,
    PAIR,
    SPACIOUS,
    Arms,
    hand_over,
    in_motion,
    move,
    nan_of,
    off_by,
    run,
    stack_on,
    supervised,
    trajectory,
)

HANDS = ("left_hand", "right_hand")
LEFT_HAND = ("left_hand", "right_arm")


@pytest.fixture
def plant(scene: SceneConfig) -> Arms:
    return Arms(scene)


@pytest.mark.parametrize("hold_first", [True, False])
def test_a_hold_keeps_the_set_that_is_active_when_it_is_confirmed(
    plant: Arms,
    hold_first: bool,
) -> None:
    stack = stack_on(plant)
    hand_over(stack, "moveit", PAIR)
    if hold_first:
        stack.request("hold")
        stack.switch_controllers(DEFAULT_CONTROLLERS)
    else:
        stack.switch_controllers(DEFAULT_CONTROLLERS)
        stack.request("hold")
    run(stack, 100)
    assert stack.state is ArbiterState.HOLDING
    assert stack.manager.active == DEFAULT_CONTROLLERS


def test_a_hold_that_names_its_set_gets_it(plant: Arms) -> None:
    stack = stack_on(plant)
    hand_over(stack, "moveit")
    stack.request("hold", PAIR)
    stack.switch_controllers(DEFAULT_CONTROLLERS)
    run(stack, 100)
    assert stack.state is ArbiterState.HOLDING
    assert stack.manager.active == PAIR


def test_a_repeated_request_of_who_drives_takes_back_no_hold(plant: Arms) -> None:
    stack = in_motion(plant)
    began = plant.q.copy()
    stack.request("hold")
    stack.request("moveit")
    assert run(stack, 800) == []
    assert np.abs(plant.q - began).max() < 0.15
    assert [(r.source, r.name) for r in stack.refusals] == [("moveit", "superseded")]
    assert stack.source is None


@pytest.mark.parametrize("wrong", [np.nan, 1000.0])
def test_one_wrong_velocity_at_a_switch_sends_the_arms_nowhere(plant: Arms, wrong: float) -> None:
    stack = supervised(plant)
    hand_over(stack, "teleop", HANDS)
    began = plant.q.copy()
    plant.lies["v"] = nan_of(3) if np.isnan(wrong) else off_by(3, wrong)
    stack.switch_controllers(DEFAULT_CONTROLLERS)
    plant.lies.clear()
    run(stack, 500)
    assert np.isfinite(stack.output.q_target).all()
    assert np.abs(stack.output.q_target - began).max() < 1e-3
    assert np.abs(plant.q - began).max() < 1e-3


def test_hands_that_give_way_to_joints_in_motion_are_drawn_nowhere(plant: Arms) -> None:
    stack = supervised(plant, config_of_supervisor=SPACIOUS)
    hand_over(stack, "teleop", HANDS)
    for tick in range(600):
        if stack.tick_next:
            goal = HOME + tick / 600 * np.eye(DOF)[0]
            stack.propose("teleop", JointCommand(goal, OPEN, plant.time, tick + 1))
        run(stack, 1)
    assert plant.v[0] > 1.0
    stack.switch_controllers(DEFAULT_CONTROLLERS)
    positions = []
    for _ in range(800):
        assert run(stack, 1) == []
        positions.append(plant.q[0])
    assert max(positions) - positions[-1] < 0.01


@pytest.mark.parametrize("joint", [0, 5])
def test_the_end_of_one_arms_trajectory_leaves_the_streamed_arm_alone(
    plant: Arms,
    joint: int,
) -> None:
    stack = supervised(plant)
    hand_over(stack, "moveit")
    motion = move(HOME[:7], HOME[:7] + 0.05, 0.4)
    assert stack.propose("moveit", trajectory(stack, motion, group="left_arm")) is None
    target = HOME[7:].copy()
    torques = []
    speeds = []
    for tick in range(600):
        if stack.tick_next:
            target[joint] += 0.02
            command = JointCommand(target, OPEN, plant.time, tick + 2, "right_arm")
            assert stack.propose("moveit", command) is None
        assert run(stack, 1) == []
        torques.append(stack.manager.tau)
        speeds.append(plant.v[7 + joint])
    around_end = slice(380, 500)
    assert min(speeds[around_end]) > 0.95
    assert np.abs(np.diff(torques[around_end], axis=0)).max() < 0.5


def test_stiff_controllers_take_over_from_a_blocked_hand_where_it_is(
    world: World,
    kinematics: Kinematics,
) -> None:
    """They do not press on towards the old target."""
    stack = supervised(world)  # type: ignore[arg-type]
    hand_over(stack, "moveit", LEFT_HAND)
    floor_m = kinematics.tcp_poses(world.q)[0][2, 3] - 0.004
    goal = HOME.copy()
    goal[1] += 0.06
    goal[3] -= 0.03
    command = trajectory(stack, move(world.q, goal, 1.5), gripper=CLOSED)
    assert stack.propose("moveit", command) is None
    pressed_n = []
    for tick in range(3000):
        if tick == 1700:
            assert not stack.executing
            stack.switch_controllers(PAIR)
        J = kinematics.tcp_jacobians(world.q)[0]
        height_m = kinematics.tcp_poses(world.q)[0][2, 3]
        force_n = max(0.0, 1e4 * (floor_m - height_m) - 100.0 * float(J[2] @ world.v))
        world.data.qfrc_applied[world.joints.qvel] = force_n * J[2]
        pressed_n.append(force_n)
        assert run(stack, 1) == []
    assert 5.0 < pressed_n[1699] < 15.0
    assert max(pressed_n[1700:]) < 15.0


# The manager ------------------------------------------------------------------------------------------------


def test_a_set_that_does_not_claim_every_joint_once_is_refused_and_nothing_changes(
    plant: Arms,
) -> None:
    stack = stack_on(plant)
    stack.step()
    for names, reason in (
        (("left_arm",), "unclaimed: the right arm"),
        ((), "unclaimed: the left arm"),
        (("both_arms", "right_arm"), "doubly_claimed: the right arm.*both_arms and right_arm"),
        (
            ("object_impedance",),
            "not_ready: controller object_impedance: it has not been told what is held",
        ),
    ):
        with pytest.raises(ControllerSwitchError, match=reason):
            stack.switch_controllers(names)
        with pytest.raises(ControllerSwitchError, match=reason):
            stack.request("moveit", names)
        assert stack.manager.active == ("both_arms",)
    with pytest.raises(UsageError, match=r"(?s)no controller 'left'.*did you mean 'left_arm'"):
        stack.switch_controllers(("left", "right"))
    stack.step()
    assert stack.source is None, "a refused request left something behind"


def test_no_switch_of_controllers_under_a_running_trajectory(plant: Arms) -> None:
    stack = stack_on(plant)
    hand_over(stack, "moveit")
    stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.1, 0.3)))
    stack.step()
    with pytest.raises(ControllerSwitchError, match="under_way"):
        stack.switch_controllers(PAIR)
    while stack.executing:
        stack.step()
    stack.step()
    stack.switch_controllers(PAIR)
    assert stack.manager.active == PAIR


def test_a_controller_that_raises_as_it_takes_over_changes_nothing(
    plant: Arms,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def torques(raising: bool) -> list[Array]:
        plant.reset()
        stack = stack_on(plant)
        hand_over(stack, "moveit")
        stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.1, 0.3)))
        while stack.executing:
            stack.step()
        if raising:
            monkeypatch.setattr(stack.manager["right_arm"], "activate", singular)
            with pytest.raises(SingularPostureError):
                stack.switch_controllers(PAIR)
        assert stack.manager.active == ("both_arms",)
        for _ in range(50):
            stack.step()
        return list(plant.torques)

    def singular(q: Array, v: Array) -> None:
        raise SingularPostureError("the right hand has lost a direction of motion")

    np.testing.assert_array_equal(torques(raising=True), torques(raising=False))


def test_a_switch_of_controllers_in_motion_does_not_jolt(plant: Arms) -> None:
    stack = stack_on(plant)
    hand_over(stack, "teleop")
    steps = []
    sequence = 0
    switched_at = None
    for k in range(600):
        if stack.tick_next:
            sequence += 1
            target = HOME + 0.4 * minimum_jerk(k / 500)[0]
            stack.propose("teleop", JointCommand(target, OPEN, plant.time, sequence))
        if k == 250:
            assert np.abs(plant.v).max() > 0.8
            before = plant.torques[-1]
            stack.switch_controllers(PAIR)
            switched_at = len(plant.torques)
        stack.step()
        steps.append(stack.manager.tau)
    assert switched_at is not None
    jump = float(np.abs(plant.torques[switched_at] - before).max())
    assert jump < 1e-9, "the first torque after the switch is the last one before it"
    np.testing.assert_allclose(plant.q, HOME + 0.4, atol=0.02)


def test_a_mode_that_drives_changes_to_the_controllers_it_names(plant: Arms) -> None:
    stack = stack_on(plant)
    hand_over(stack, "moveit")
    stack.request("moveit", PAIR)
    stack.step()
    assert stack.source == "moveit"
    assert stack.manager.active == PAIR
    stack.request("moveit")  # none named: those that drive stay
    stack.step()
    assert stack.manager.active == PAIR
    stack.propose("moveit", trajectory(stack, move(plant.q, HOME + 0.1, 0.3)))
    stack.step()
    stack.request("moveit", PAIR)  # nothing would change
    with pytest.raises(ControllerSwitchError, match="under_way"):
        stack.request("moveit", ("both_arms",))
    assert stack.manager.active == PAIR


@pytest.mark.parametrize("names", [DEFAULT_CONTROLLERS, PAIR, HANDS])
def test_after_an_object_path_the_arms_stay_where_it_has_brought_them(
    plant: Arms,
    names: tuple[str, ...],
) -> None:
    """Joint controllers take over at the posture, not at the joint target of before the path."""
    here = HandsObject(plant)
    stack = supervised(plant, sensor=here)
    stack.impedance.configure(here.held())
    hand_over(stack, "moveit", OBJECT_CONTROLLERS)
    (x, y, z) = (float(value) for value in here.pose()[:3, 3])
    began = plant.q
    path = ObjectPath(Waypoint((x, y, z), 0.0, 0.0), [Waypoint((x, y + 0.1, z + 0.05), 0.0, 1.5)])
    assert stack.propose("moveit", ObjectCommand(path, lambda t: 0.0, OPEN, plant.time, 1)) is None
    stack.step()
    while stack.executing:
        stack.step()
    assert np.abs(plant.q - began).max() > 0.1
    q = plant.q
    stack.switch_controllers(names)
    for _ in range(600):
        stack.step()
    assert stack.reflex is None
    assert np.abs(plant.q - q).max() < 0.002
