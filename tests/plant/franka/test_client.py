"""The vendor's client library against the emulator: it connects, moves, and names our refusals.

Skipped without the extra `minidual[franka]`.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest

from minidual.plant.franka import wire
from minidual.plant.franka.errors import ERRORS
from minidual.robot.models import PANDA

franky = pytest.importorskip("franky", reason="needs the extra minidual[franka] (franky-control)")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

HOSTS = ("127.0.0.51", "127.0.0.52")


@pytest.fixture(scope="module")
def emulator() -> Iterator[subprocess.Popen[str]]:
    """`minidual plant serve` in a process of its own: the client's loop and ours must not share a lock."""
    serve = [sys.executable, "-m", "minidual.cli", "plant", "serve", "--pace", "client"]
    process = subprocess.Popen(
        [*serve, "--hosts", ",".join(HOSTS)],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    for line in process.stderr:
        if "emulator ready" in line:
            break
    yield process
    process.send_signal(signal.SIGTERM)
    out, _ = process.communicate(timeout=60)
    assert "emulator ended" in out
    assert process.returncode == 0


@pytest.fixture(scope="module")
def robots(emulator: subprocess.Popen[str]) -> list:
    made = [
        franky.Robot(
            host, realtime_config=franky.RealtimeConfig.Ignore, relative_dynamics_factor=0.3
        )
        for host in HOSTS
    ]
    for robot in made:
        robot.set_collision_behavior(40.0, 60.0)
    return made


def test_names_of_errors_are_the_clients() -> None:
    named = {name for name in dir(franky.Errors) if not name.startswith("_")}
    assert named == {error.name for error in ERRORS}


def test_states_are_read_field_by_field(robots: list) -> None:
    state = robots[0].state
    assert np.allclose(state.q, PANDA.home, atol=1e-3)
    assert state.robot_mode == franky.RobotMode.Idle
    assert state.m_ee == pytest.approx(0.73)
    assert state.control_command_success_rate == 1.0
    hand = robots[0].model.pose(franky.Frame.EndEffector, state)
    assert np.allclose(hand.matrix, state.O_T_EE.matrix, atol=2e-3)


def test_both_arms_move_as_told_at_the_same_time(robots: list) -> None:
    goals = []
    for robot in robots:
        goal = np.array(robot.state.q)
        goal[3] += 0.04
        goals.append(goal)
        robot.move(franky.JointMotion(goal), asynchronous=True)
    for robot, goal in zip(robots, goals, strict=True):
        assert robot.join_motion(timeout=100.0)
        assert np.abs(np.array(robot.state.q) - goal).max() < 2e-3


def test_full_speed_of_the_client_is_within_the_limits(robots: list) -> None:
    robot = robots[1]
    robot.relative_dynamics_factor = 1.0
    goal = np.array(robot.state.q)
    goal[[1, 3]] += (0.05, -0.05)
    robot.move(franky.JointMotion(goal))
    assert not robot.has_errors
    robot.relative_dynamics_factor = 0.3


def test_the_client_names_a_refusal_and_recovers(robots: list) -> None:
    robot = robots[0]
    robot.relative_dynamics_factor = 0.6
    goal = np.array(robot.state.q)
    goal[3] = PANDA.q_lower[3] - 0.05
    with pytest.raises(
        franky.ControlException, match=r"joint_motion_generator_\w+_limits_violation"
    ):
        robot.move(franky.JointMotion(goal))
    assert robot.has_errors
    assert robot.recover_from_errors()
    robot.relative_dynamics_factor = 0.3
    robot.move(franky.JointMotion(np.array(robot.state.q)))


def test_hands_move_and_grasp(robots: list) -> None:
    hand = franky.Gripper(HOSTS[0])
    assert hand.server_version == wire.HAND_VERSION
    assert hand.width == pytest.approx(0.08, abs=1e-3)
    assert hand.move(0.05, 0.1)
    assert hand.width == pytest.approx(0.05, abs=2e-3)
    assert not hand.grasp(0.0, 0.1, 30.0, 0.005, 0.005)  # there is nothing
    assert not hand.is_grasped
    hand.open(0.1)


def test_a_killed_emulator_is_a_network_error() -> None:
    started = time.monotonic()
    with pytest.raises(franky.NetworkException):
        franky.Robot("127.0.0.99", realtime_config=franky.RealtimeConfig.Ignore)
    assert time.monotonic() - started < 60.0
