"""Resets and recoveries: where control begins, from which torques, and what is left of the time before."""

from __future__ import annotations

import numpy as np
import pytest

from minidual import emergency
from minidual.config.scene import SceneConfig
from minidual.control.commands import ArbiterState
from minidual.control.hand_impedance import InHand
from minidual.control.reflexes import ReflexError
from minidual.control.stack import DEFAULT_CONTROLLERS, OBJECT_CONTROLLERS
from minidual.control.supervisor import Supervisor
from minidual.errors import UsageError
from minidual.plant.world import World
from minidual.robot.pair import Array
from tests.support.carried_rod import KINEMATICS, Carried
from tests.support.panda import HOME
from tests.support.stacks import (
    Arms,
    hand_over,
    in_motion,
    move,
    nan_of,
    run,
    stack_on,
    supervised,
    trajectory,
)


@pytest.fixture
def plant(scene: SceneConfig) -> Arms:
    return Arms(scene)


@pytest.fixture
def carried(world: World) -> Carried:
    return Carried(world)


# At rest ----------------------------------------------------------------------------------------------------


def test_arms_recover_at_rest_where_they_are_and_without_a_step_of_torque(world: World) -> None:
    stack = supervised(world)  # type: ignore[arg-type]
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.6, 1.0))) is None
    run(stack, 500)
    stack.supervisor.estop("pressed")
    with pytest.raises(ReflexError, match="emergency_stop"):
        stack.step()
    assert np.abs(world.v).max() > 1.0
    with pytest.raises(UsageError, match=r"may not recover while they move .*still is below"):
        stack.recover()
    with pytest.raises(UsageError, match="may not drive: the supervisor stopped the arms"):
        stack.request("moveit")
    run(stack, 600)
    rest = world.q
    torques = [stack.applied]
    stack.recover()
    for _ in range(500):
        stack.step()
        torques.append(stack.applied)
    assert np.abs(world.q - rest).max() < 1e-4
    assert np.abs(np.diff(torques, axis=0)).max() < 0.25
    assert (stack.state, stack.source, stack.reflex) == (ArbiterState.HOLDING, None, None)
    hand_over(stack, "teleop")


def test_control_does_not_start_on_arms_that_move(plant: Arms) -> None:
    stack = in_motion(plant)
    with pytest.raises(UsageError, match=r"control starts at rest .*moves at \d\.\d+ rad/s"):
        stack.reset()
    with pytest.raises(UsageError, match="control starts at rest"):
        supervised(plant)
    assert run(stack, 20) == [], "the refused reset has changed nothing"
    assert stack.source == "moveit"


def test_a_reset_that_an_emergency_stop_refuses_leaves_the_hands(plant: Arms) -> None:
    plant.grip_something()
    stack = supervised(plant)
    run(stack, 10)
    target_m = stack.grippers.targets_m.copy()
    emergency.press("a test")
    run(stack, 2)
    try:
        with pytest.raises(emergency.EmergencyStop):
            stack.reset()
    finally:
        emergency.release()
    assert (stack.grippers.openings == 0.0).all()
    assert np.abs(stack.grippers.targets_m - target_m).max() < 1e-3


def test_a_torque_that_is_not_measured_at_a_reset_reaches_no_motor(plant: Arms) -> None:
    plant.grip_something()
    stack = supervised(plant)
    run(stack, 5)
    plant.tau = nan_of(3)(plant.tau)
    stack.reset()
    stack.supervisor.estop()
    plant.torques.clear()
    assert run(stack, 20) == ["emergency_stop"]
    assert np.isfinite(plant.torques).all()


def test_a_stack_that_is_reset_bears_the_arms_before_its_first_step(world: World) -> None:
    stack = supervised(world)  # type: ignore[arg-type]
    world.reset()
    stack.reset()
    stack.recover()
    began_m = [T[2, 3] for T in KINEMATICS.tcp_poses(world.q)]
    lowest_m = np.full(2, np.inf)
    for _ in range(300):
        stack.step()
        lowest_m = np.minimum(lowest_m, [T[2, 3] for T in KINEMATICS.tcp_poses(world.q)])
    np.testing.assert_allclose(lowest_m, began_m, atol=2e-4)


def test_a_reset_forgets_what_a_hand_was_told_to_hold(plant: Arms) -> None:
    stack = supervised(plant)
    planned = np.eye(4)
    planned[0, 3] = 0.02
    in_hand = InHand("peg", np.eye(4), planned)
    stack.hands[0].law.held = in_hand
    stack.hands[1].law.other = in_hand
    plant.reset()
    stack.reset()
    assert stack.hands[0].law.held.name == ""
    assert stack.hands[1].law.other is None


def test_arms_that_move_may_not_recover_after_their_clock_began_anew(plant: Arms) -> None:
    plant.steps = 3_600_000
    stack = supervised(plant)
    run(stack, 100)
    plant.steps = 0
    assert run(stack, 300) == ["measurement.clock"]
    stack.recover()
    hand_over(stack, "moveit")
    assert stack.propose("moveit", trajectory(stack, move(HOME, HOME + 0.4, 1.0))) is None
    assert run(stack, 450) == []
    stack.supervisor.estop()
    run(stack, 1)
    with pytest.raises(UsageError, match="while they move"):
        stack.recover()


def test_a_measurement_that_was_lost_in_a_halt_does_not_prevent_a_recovery(plant: Arms) -> None:
    stack = in_motion(plant)
    stack.halt("moveit")
    run(stack, 3)
    plant.lies["q"] = nan_of(*range(14))
    run(stack, 1)
    plant.lies.clear()
    run(stack, 800)
    assert stack.reflex is not None
    assert stack.reflex.reflex.label == "measurement.not_finite"
    stack.recover()
    assert run(stack, 300) == []
    hand_over(stack, "moveit")


def test_nothing_of_an_old_trajectory_comes_back_after_a_recovery(plant: Arms) -> None:
    stack = supervised(plant)
    hand_over(stack, "moveit")
    way = np.array([0.6, 0.3, 0.0, 0.4, 0.0, 0.0, 0.0])
    motion = move(HOME[:7], HOME[:7] + way, 0.9, "left_arm")
    assert stack.propose("moveit", trajectory(stack, motion, group="left_arm")) is None
    assert run(stack, 450) == []
    stack.fail(RuntimeError("a packet was lost"))
    assert run(stack, 600) == ["controller_failed"]
    stack.recover()
    hand_over(stack, "moveit")
    q = plant.q.copy()
    motion = move(q[:7], q[:7] - 0.8 * way, 0.9, "left_arm")
    assert stack.propose("moveit", trajectory(stack, motion, group="left_arm")) is None
    references = []
    for _ in range(1200):
        assert run(stack, 1) == []
        references.append(stack.manager.reference.copy())
    assert np.abs(np.diff(references, axis=0)).max() < 0.005
    np.testing.assert_allclose(plant.q[:7], q[:7] - 0.8 * way, atol=0.01)


# With a rod in both hands -----------------------------------------------------------------------------------


@pytest.mark.parametrize("change", ["switch", "halt"])
def test_a_recovery_goes_on_from_the_torques_that_were_applied(
    carried: Carried,
    change: str,
) -> None:
    """Not from what the law asks for while the stop is latched."""
    carried.lose()
    carried.run(1000)
    assert carried.names
    if change == "switch":
        carried.stack.switch_controllers(DEFAULT_CONTROLLERS)
    else:
        carried.stack.halt("moveit")
    carried.fastest = 0.0
    before = KINEMATICS.tcp_poses(carried.world.q)
    carried.stack.recover()
    carried.run(600)
    after = KINEMATICS.tcp_poses(carried.world.q)
    assert carried.fastest < 0.05
    for T, T_after in zip(before, after, strict=True):
        assert np.linalg.norm((T - T_after)[:3, 3]) < 0.002


def test_a_recovery_that_fails_leaves_the_stop_latched(carried: Carried) -> None:
    carried.carry((0.0, -0.3, 0.0), 1.5)
    carried.run(700)
    carried.stop()
    carried.sensor.failing = True
    with pytest.raises(OSError, match="camera is gone"):
        carried.stack.recover()
    carried.sensor.failing = False
    before = carried.world.object_pose()
    assert carried.stack.reflex is not None
    carried.run(600)
    assert np.linalg.norm((carried.world.object_pose() - before)[:3, 3]) < 1e-3
    carried.stack.recover()
    carried.run(600)
    assert carried.names == ["emergency_stop"]


def test_a_grip_that_was_lost_in_a_stop_is_named_once_after_the_recovery(carried: Carried) -> None:
    carried.stack.switch_controllers(DEFAULT_CONTROLLERS)
    carried.hold(300)
    carried.stop()
    carried.lose()
    carried.run(400)
    carried.stack.recover()
    carried.run(50)
    assert carried.names == ["emergency_stop", "gripper_opened"]
    carried.stack.recover()
    carried.run(400)
    assert carried.names == ["emergency_stop", "gripper_opened"]


def test_after_a_lost_grip_joint_control_recovers_in_place_of_the_object_law(
    scene: SceneConfig,
) -> None:
    """The empty hand does not rise under the weight of 1 kg that the law bore."""
    world = World(scene)  # its own model: the mass changes
    carried = Carried(world, 1.0)
    command = world.command

    def left_hand_open(tau: Array, fingers_m: Array) -> None:
        command(tau, np.array([0.04, fingers_m[1]]))

    world.command = left_hand_open  # type: ignore[method-assign]
    carried.run(1000)
    assert carried.names == ["gripper_opened"]
    carried.fastest = 0.0
    before_m = KINEMATICS.tcp_poses(world.q)[0][2, 3]
    carried.stack.recover()
    carried.run(800)
    assert carried.stack.manager.active == DEFAULT_CONTROLLERS
    assert carried.fastest < 0.5
    assert KINEMATICS.tcp_poses(world.q)[0][2, 3] < before_m + 0.005


@pytest.mark.parametrize("new", [False, True], ids=["a reset", "another stack"])
@pytest.mark.parametrize("mass_kg", [0.2, 3.0])
def test_control_that_begins_anew_with_full_hands_goes_on_from_the_torques_that_hold(
    scene: SceneConfig,
    mass_kg: float,
    new: bool,
) -> None:
    world = World(scene)  # its own model: the mass changes
    carried = Carried(world, mass_kg)
    carried.run(400)
    stack = carried.stack
    torques = [stack.applied]
    height_m = carried.height_m
    if new:
        stack = stack_on(world, supervisor=Supervisor(dt_s=world.dt))
    else:
        stack.reset()
    lowest_m = height_m
    for _ in range(1500):
        stack.step()
        torques.append(stack.applied)
        lowest_m = min(lowest_m, carried.height_m)
    assert np.abs(np.diff(torques, axis=0)).max() <= 1.0 + 1e-9
    assert height_m - lowest_m < 0.007
    assert stack.output.gripper.tolist() == [0.0, 0.0]


# Hands ------------------------------------------------------------------------------------------------------


def test_an_object_that_is_torn_out_is_named_under_joint_control(carried: Carried) -> None:
    carried.stack.switch_controllers(DEFAULT_CONTROLLERS)
    carried.hold(300)
    assert carried.names == []
    carried.lose()
    carried.hold(60)
    assert carried.names == ["gripper_opened"]


def test_a_grip_that_reads_too_high_does_not_open_the_hand_unnamed(
    carried: Carried,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    carried.stack.switch_controllers(DEFAULT_CONTROLLERS)
    carried.hold(300)
    true_grip = World.grip.fget  # type: ignore[attr-defined]

    def wrong_grip(world: World) -> Array:
        return true_grip(world) * [0.0, 1.0] + [80.0, 0.0]

    monkeypatch.setattr(World, "grip", property(wrong_grip))
    held_m = float(carried.world.fingers[0])
    carried.hold(1500)
    assert carried.names == ["gripper_opened"]
    assert carried.world.fingers[0] < held_m + 0.004


def test_an_emergency_stop_keeps_what_closed_hands_hold(carried: Carried) -> None:
    carried.stop()
    carried.run(500)
    assert carried.height_m > 0.14
    assert carried.world.grip.min() > 55.0
    carried.stack.recover()
    assert carried.stack.manager.active == OBJECT_CONTROLLERS


@pytest.mark.parametrize("closes", [True, False])
def test_an_emergency_stop_stops_fingers_on_their_way_until_a_recovery(
    world: World,
    closes: bool,
) -> None:
    stack = supervised(world)  # type: ignore[arg-type]
    hand_over(stack, "moveit")
    still = move(HOME, HOME, 3.0)
    if not closes:
        command = trajectory(stack, still, 1, gripper=np.zeros(2))
        assert stack.propose("moveit", command) is None
        run(stack, 900)
        stack.request("hold")
        run(stack, 200)
        hand_over(stack, "moveit")
    openings = np.full(2, 0.0 if closes else 1.0)
    assert stack.propose("moveit", trajectory(stack, still, 2, gripper=openings)) is None
    run(stack, 200 if closes else 400)
    began_m = world.fingers.copy()
    assert (began_m > 0.005).all()
    assert (began_m < 0.035).all()
    stack.supervisor.estop()
    assert run(stack, 800) == ["emergency_stop"]
    assert np.abs(world.fingers - began_m).max() < 0.003
    assert world.grip.max() < 5.0
    stack.recover()
    run(stack, 800)
    if closes:  # what was commanded goes on
        assert world.fingers.max() < 0.001
    else:
        assert world.fingers.min() > 0.039
