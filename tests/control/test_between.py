"""What one trial, hold or set of controllers leaves to the next: no load and no target."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.control.commands import JointCommand
from minidual.control.reflexes import ReflexError
from minidual.control.supervisor import Supervisor
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from tests.support.panda import HOME
from tests.support.stacks import OPEN, hand_over, move, stack_on, trajectory

CLOSED = np.zeros(2)
HAND = ("left_hand", "right_arm")


def height_m(world: World) -> float:
    return float(Kinematics().tcp_poses(world.q)[0][2, 3])


def pulled_down(world: World, force_n: float) -> None:
    """Pull the left hand down."""
    world.data.qfrc_applied[world.joints.qvel] = (
        -force_n * Kinematics().tcp_jacobians(world.q)[0][2]
    )


@pytest.mark.parametrize("ticks", [0, 1, 2])
def test_a_stop_at_the_beginning_of_a_trial_bears_no_load_of_the_last_one(
    world: World,
    ticks: int,
) -> None:
    """Before, the empty hand rose by 46 mm."""
    supervisor = Supervisor(dt_s=world.dt)
    stack = stack_on(world, supervisor=supervisor)
    hand_over(stack, "moveit")
    stack.propose("moveit", JointCommand(HOME, CLOSED, world.time, 1))
    for tick in range(800):
        pulled_down(world, 29.4 * min(1.0, tick / 300))
        stack.payload.bear(0, 3.0)
        stack.step()
    world.reset()
    stack.reset()
    began_m = height_m(world)
    for _ in range(ticks):
        stack.step()
    supervisor.estop("between two trials")
    with pytest.raises(ReflexError):
        stack.step()
    for _ in range(600):
        stack.step()
    assert abs(height_m(world) - began_m) < 0.001


@pytest.mark.parametrize("drives_again", [False, True])
def test_a_soft_hand_that_is_jammed_in_a_hold_is_not_thrown_when_it_comes_free(
    world: World,
    drives_again: bool,
) -> None:
    """Before, the hold learnt 30 N; a hand of 10 N at most then rose by 119 mm (in the hold by 29 mm)."""
    stack = stack_on(world, supervisor=Supervisor(dt_s=world.dt))
    hand_over(stack, "moveit", HAND)
    stack.propose("moveit", JointCommand(HOME, CLOSED, world.time, 1))
    began_m = height_m(world)
    kinematics = Kinematics()
    pull_n = 0.0
    highest_m = 0.0
    free = 4100 if drives_again else 3500
    for tick in range(free + 1500):
        if tick == 500:
            stack.request("hold")
        if tick == 3500 and drives_again:
            stack.request("moveit", HAND)
        if tick < free:
            J = kinematics.tcp_jacobians(world.q)[0]
            p = kinematics.tcp_poses(world.q)[0][2, 3]
            ledge_m = began_m - 0.006 * min(1.0, tick / 400)
            pull_n = max(0.0, 2e4 * (p - ledge_m) + 100.0 * float(J[2] @ world.v))
        else:
            pull_n = 0.0
            highest_m = max(highest_m, height_m(world) - began_m)
        pulled_down(world, pull_n)
        if tick == free - 1:
            assert 5.0 < pull_n < 15.0
        stack.step()
    assert highest_m < 0.01


@pytest.mark.parametrize("joint", [0, 1, 5])
def test_the_end_of_one_arms_trajectory_leaves_the_streamed_arm_alone(
    world: World,
    joint: int,
) -> None:
    """Before, it braked: from 1.00 to 0.82 rad/s, and the torque asked for stepped by 8 to 11 Nm."""
    stack = stack_on(world, supervisor=Supervisor(dt_s=world.dt))
    hand_over(stack, "moveit")
    motion = move(HOME[:7], HOME[:7] + 0.05, 0.4)
    stack.propose("moveit", trajectory(stack, motion, group="left_arm"))
    target = HOME[7:].copy()
    asked = []
    speeds = []
    for k in range(600):
        if stack.tick_next:
            target[joint] += 0.02
            assert (
                stack.propose("moveit", JointCommand(target, OPEN, world.time, k + 2, "right_arm"))
                is None
            )
        stack.step()
        asked.append(stack.manager.tau)
        speeds.append(world.v[7 + joint])
    around = slice(380, 500)
    assert min(speeds[around]) > 0.95
    assert np.abs(np.diff(asked[around], axis=0)).max() < 0.5


def test_stiff_controllers_take_over_from_a_blocked_hand_where_it_is(world: World) -> None:
    """Before, they pressed on towards the old target: 36 N and `joint_contact`."""
    stack = stack_on(world, supervisor=Supervisor(dt_s=world.dt))
    hand_over(stack, "moveit", HAND)
    kinematics = Kinematics()
    began_m = height_m(world)
    q = HOME.copy()
    q[[1, 3]] += 0.06, -0.03
    blocked_m = began_m - 0.004
    assert kinematics.tcp_poses(q)[0][2, 3] < began_m - 0.02
    stack.propose("moveit", trajectory(stack, move(world.q, q, 1.5)))
    pressed = []
    for tick in range(3500):
        if tick == 1700:
            assert not stack.executing
            stack.switch_controllers(("left_arm", "right_arm"))
        J = kinematics.tcp_jacobians(world.q)[0]
        p = kinematics.tcp_poses(world.q)[0][2, 3]
        pressed.append(max(0.0, 1e4 * (blocked_m - p) - 100.0 * float(J[2] @ world.v)))
        pulled_down(world, -pressed[-1])
        stack.step()
    assert stack.reflex is None
    assert 5.0 < pressed[1699] < 15.0
    assert max(pressed[1700:]) < 15.0
