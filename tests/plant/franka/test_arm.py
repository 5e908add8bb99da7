"""One emulated controller: modes, what ends a motion, and how the arm brakes."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.plant.franka import wire
from minidual.plant.franka.arm import ArmController
from minidual.plant.franka.limits import LOST_PACKETS_MAX, MeasuredState, limits_of
from minidual.plant.franka.wire import (
    Controller,
    Generator,
    MoveStatus,
    RecoveryStatus,
    RobotMode,
    SetterStatus,
)
from minidual.robot.models import PANDA

HOME = np.array(PANDA.home)
ONE = np.eye(7)[1]
J = np.random.default_rng(1).standard_normal((6, 7))


@pytest.fixture
def arm() -> ArmController:
    controller = ArmController(limits_of(PANDA), HOME, ((-1.0, 1.0),) * 3)
    sense(controller)
    return controller


def sense(arm: ArmController, **changes: object) -> None:
    values = {
        "q": arm.desired.q.copy(),
        "v": arm.desired.v.copy(),
        "tau": np.zeros(7),
        "speed_m_per_s": 0.0,
        "position_m": np.zeros(3),
    }
    arm.sense(MeasuredState(**{**values, **changes}), np.eye(4), J, np.zeros(7))


def message(**values: object) -> np.void:
    record = np.zeros((), wire.ARM_COMMAND)
    for name, value in values.items():
        record[name] = value
    return record


def started(
    arm: ArmController, generator: Generator, law: int = Controller.JOINT_IMPEDANCE
) -> None:
    assert arm.move(law, generator) is MoveStatus.MOTION_STARTED


def moving(arm: ArmController) -> None:
    """Bring the arm to a constant velocity by joint velocities."""
    started(arm, Generator.JOINT_VELOCITY)
    for k in range(1, 101):
        v = 0.2 * (0.5 - 0.5 * np.cos(np.pi * k / 100))
        arm.command(message(dq_c=v * ONE))
        assert arm.mode is RobotMode.MOVE


def test_a_motion_starts_runs_and_ends(arm: ArmController) -> None:
    started(arm, Generator.JOINT_POSITION)
    arm.command(message(q_c=HOME))
    assert arm.desired.generator_code == 1
    arm.command(message(q_c=HOME, motion_generation_finished=True))
    assert arm.take_finished() is MoveStatus.SUCCESS
    assert arm.take_finished() is None
    assert arm.mode is RobotMode.IDLE
    assert arm.desired.generator_code == wire.IDLE_GENERATOR


def test_a_second_motion_is_refused_and_so_are_wrong_combinations(arm: ArmController) -> None:
    assert arm.move(7, 0) is MoveStatus.INVALID_ARGUMENT
    assert arm.move(Controller.JOINT_IMPEDANCE, Generator.NONE) is MoveStatus.INVALID_ARGUMENT
    started(arm, Generator.JOINT_POSITION)
    assert arm.move(0, 0) is MoveStatus.NOT_POSSIBLE


def test_a_jump_ends_the_motion_by_the_vendors_name(arm: ArmController) -> None:
    started(arm, Generator.JOINT_POSITION)
    arm.command(message(q_c=HOME + 0.005 * ONE))
    assert arm.mode is RobotMode.REFLEX
    assert "joint_motion_generator_velocity_discontinuity" in arm.errors
    assert arm.last_errors == arm.errors
    assert arm.take_finished() is MoveStatus.REFLEX_ABORTED
    assert arm.move(0, 0) is MoveStatus.NOT_POSSIBLE
    assert arm.recover() is RecoveryStatus.SUCCESS
    assert arm.errors == ()
    started(arm, Generator.JOINT_POSITION)


def test_a_motion_may_not_be_finished_while_it_moves(arm: ArmController) -> None:
    moving(arm)
    arm.command(message(dq_c=0.2 * ONE, motion_generation_finished=True))
    assert "joint_motion_generator_velocity_discontinuity" in arm.errors


def test_lost_commands_are_bridged_and_twenty_end_the_motion(arm: ArmController) -> None:
    moving(arm)
    before = arm.desired.q.copy()
    for _ in range(LOST_PACKETS_MAX - 1):
        arm.command(None)
    assert arm.mode is RobotMode.MOVE
    assert arm.desired.q[1] - before[1] == pytest.approx(0.2e-3 * (LOST_PACKETS_MAX - 1), rel=0.05)
    assert arm.packets.success_rate < 0.85
    arm.command(None)
    assert arm.errors == ("communication_constraints_violation",)
    assert arm.mode is RobotMode.REFLEX


def test_a_motion_whose_first_command_never_comes_ends(arm: ArmController) -> None:
    started(arm, Generator.JOINT_POSITION)
    for _ in range(499):
        arm.command(None)
    assert arm.mode is RobotMode.MOVE
    for _ in range(LOST_PACKETS_MAX):
        arm.command(None)
    assert arm.errors == ("communication_constraints_violation",)


def test_an_arm_that_is_stopped_brakes_without_a_jump(arm: ArmController) -> None:
    moving(arm)
    arm.stop()
    assert arm.take_finished() is MoveStatus.PREEMPTED
    speeds = []
    for _ in range(60):
        arm.command(None)
        speeds.append(arm.desired.v[1])
    assert np.abs(np.diff([0.2, *speeds])).max() <= 0.9 * 7.5e-3 + 1e-9
    assert speeds[-1] == 0.0
    assert arm.move(0, 0) is MoveStatus.MOTION_STARTED


def test_a_client_that_is_gone_is_a_loss_of_communication(arm: ArmController) -> None:
    moving(arm)
    arm.disconnected()
    assert arm.errors == ("communication_constraints_violation",)


def test_the_stop_button(arm: ArmController) -> None:
    moving(arm)
    arm.user_stop(pressed=True)
    assert arm.take_finished() is MoveStatus.EMERGENCY_ABORTED
    assert arm.mode is RobotMode.USER_STOPPED
    assert arm.recover() is RecoveryStatus.EMERGENCY_ABORTED
    arm.user_stop(pressed=False)
    assert arm.mode is RobotMode.IDLE


def test_collisions_end_a_motion_but_not_rest(arm: ArmController) -> None:
    arm.feel(50.0 * ONE, np.zeros(6))
    assert arm.mode is RobotMode.IDLE
    started(arm, Generator.JOINT_POSITION)
    arm.feel(19.0 * ONE, np.zeros(6))
    assert arm.mode is RobotMode.MOVE
    arm.feel(21.0 * ONE, np.zeros(6))
    assert arm.errors == ("joint_reflex",)


def test_thresholds_while_accelerating_are_others(arm: ArmController) -> None:
    settings = np.zeros((), wire.COLLISION_BEHAVIOR)
    for name in settings.dtype.names:
        settings[name] = 50.0 if "acceleration" in name else 10.0
    assert arm.set_thresholds(settings) is SetterStatus.SUCCESS
    moving(arm)
    arm.desired.a = ONE.copy()
    arm.feel(20.0 * ONE, np.zeros(6))
    assert arm.mode is RobotMode.MOVE
    arm.desired.a = np.zeros(7)
    arm.feel(np.zeros(7), 20.0 * np.eye(6)[0])
    assert arm.errors == ("cartesian_reflex",)
    settings["upper_force_nominal"] = -1.0
    assert arm.set_thresholds(settings) is SetterStatus.INVALID_ARGUMENT


def test_what_is_measured_is_checked_at_rest_too(arm: ArmController) -> None:
    sense(arm, position_m=np.array([0.0, 0.0, 2.0]))
    assert arm.errors == ("cartesian_position_limits_violation",)
    assert arm.recover() is RecoveryStatus.SUCCESS
    sense(arm, q=HOME + 3.0)
    assert arm.errors == ("joint_position_limits_violation",)
    assert arm.recover() is RecoveryStatus.MANUAL_RECOVERY_REQUIRED


def test_torques_drive_until_they_jump(arm: ArmController) -> None:
    started(arm, Generator.NONE, Controller.EXTERNAL)
    assert arm.desired.by_torque
    arm.command(message(tau_J_d=0.5 * ONE))
    assert arm.desired.tau[1] == 0.5
    arm.command(message(tau_J_d=5.0 * ONE))
    assert arm.errors == ("controller_torque_discontinuity",)
    assert not arm.desired.tau.any()


def test_poses_and_twists_are_followed_and_refused(arm: ArmController) -> None:
    started(arm, Generator.CARTESIAN_VELOCITY, Controller.CARTESIAN_IMPEDANCE)
    arm.command(message(O_dP_EE_c=0.0005 * np.eye(6)[0]))
    assert arm.desired.v.any()
    arm.command(message(O_dP_EE_c=2.0 * np.eye(6)[0]))
    assert "cartesian_motion_generator_velocity_limits_violation" in arm.errors
    arm.recover()
    started(arm, Generator.CARTESIAN_POSITION, Controller.CARTESIAN_IMPEDANCE)
    arm.command(message(O_T_EE_c=(2.0 * np.eye(4)).ravel()))
    assert arm.errors == ("cartesian_position_motion_generator_invalid_frame",)
