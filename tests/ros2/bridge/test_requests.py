"""What comes in on the topics: targets by array and by name, and requests for a mode."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from minidual.control.stack import ControlStack
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.ros2.bridge.bridge import Bridge
from minidual.ros2.bridge.requests import (
    BadMessageError,
    target_of_array,
    target_of_joints,
)

OPEN = np.ones(2)


class FakeTopics:
    """Topics in memory: what was published, and what is to be taken."""

    def __init__(self) -> None:
        self.messages = SimpleNamespace(
            JointState=lambda *fields: SimpleNamespace(
                **dict(
                    zip(("header", "name", "position", "velocity", "effort"), fields, strict=True)
                )
            ),
            Image=lambda *fields: SimpleNamespace(height=fields[1], data=fields[-1]),
            Float64MultiArray=list,
            String=str,
        )
        self.published: dict[str, list[Any]] = {}
        self.waiting: dict[str, list[Any]] = {}
        self.shown: list[Any] = []

    def advertise(self, topic: str, kind: Any) -> None:
        self.published[topic] = []

    def subscribe(self, topic: str, kind: Any, *, newest: bool) -> None:
        self.waiting[topic] = []

    def publish(self, topic: str, message: Any) -> None:
        self.published[topic].append(message)

    def publish_floats(self, topic: str, values: Any, label: str) -> None:
        self.published[topic].append(np.array(values))

    def publish_text(self, topic: str, text: str) -> None:
        self.published[topic].append(text)

    def take(self, topic: str) -> list[Any]:
        messages = self.waiting[topic]
        self.waiting[topic] = []
        return messages

    def header(self, frame: str = "") -> str:
        return frame

    def send(self, topic: str, data: Any) -> None:
        self.waiting[topic].append(SimpleNamespace(data=data))


@pytest.fixture
def topics() -> FakeTopics:
    return FakeTopics()


@pytest.fixture
def bridge(world, topics) -> Bridge:
    stack = ControlStack(world, Kinematics(world.robot), rate_hz=100.0)
    return Bridge(topics, stack, lambda: topics.shown.append(stack.plant.q))


def ticks(bridge: Bridge, count: int) -> None:
    for _ in range(count):
        bridge.tick()


def test_an_array_has_all_joints_and_perhaps_the_hands() -> None:
    q = DUAL_PANDA.home
    target = target_of_array(q.tolist(), DUAL_PANDA, OPEN)
    assert (target.q == q).all()
    assert target.gripper is OPEN
    target = target_of_array([*q, 0.0, 0.5], DUAL_PANDA, OPEN)
    assert target.gripper.tolist() == [0.0, 0.5]
    with pytest.raises(BadMessageError, match="3 numbers; send 14 joint targets"):
        target_of_array([0.0, 0.0, 0.0], DUAL_PANDA, OPEN)


def test_joints_are_found_by_name_and_a_finger_is_an_opening() -> None:
    names = ["left_panda_finger_joint1", *DUAL_PANDA.joint_names[::-1]]
    positions = [0.01, *DUAL_PANDA.home[::-1]]
    target = target_of_joints(SimpleNamespace(name=names, position=positions), DUAL_PANDA, OPEN)
    assert (target.q == DUAL_PANDA.home).all()
    assert target.gripper.tolist() == [0.25, 1.0]


def test_joints_without_a_position_are_named() -> None:
    positions = DUAL_PANDA.home.tolist()
    positions[3] = float("nan")
    message = SimpleNamespace(name=DUAL_PANDA.joint_names, position=positions)
    with pytest.raises(BadMessageError, match="no position of left_panda_joint4"):
        target_of_joints(message, DUAL_PANDA, OPEN)


def test_states_and_commands_go_out(bridge, topics) -> None:
    ticks(bridge, 5)
    states = topics.published["/joint_states"]
    assert len(states) == len(topics.published["/joint_commands"]) == 5
    assert states[0].name[:14] == list(DUAL_PANDA.joint_names)
    assert np.abs(np.array(states[-1].position[:14]) - DUAL_PANDA.home).max() < 1e-3
    assert states[-1].position[14:] == pytest.approx([0.04] * 4, abs=1e-3)
    assert topics.published["/minidual/mode"] == ["hold"]
    assert len(topics.shown) == 5


def test_nobody_moves_the_arms_before_a_mode_was_requested(bridge, topics) -> None:
    target = DUAL_PANDA.home + 0.05
    for _ in range(10):
        topics.send("/teleop/joint_target", target)
        bridge.tick()
    assert np.abs(topics.published["/joint_commands"][-1] - DUAL_PANDA.home).max() < 1e-6


def test_the_requested_source_drives_and_the_other_does_not(bridge, topics) -> None:
    up = DUAL_PANDA.home + 0.02
    down = DUAL_PANDA.home - 0.02
    topics.send("/mode_switch", "policy")
    for _ in range(40):
        topics.send("/policy/action", up)
        topics.send("/teleop/joint_target", down)
        bridge.tick()
    assert topics.published["/minidual/mode"][-1] == "policy"
    assert np.abs(topics.published["/joint_commands"][-1] - up).max() < 1e-6
    topics.send("/mode_switch", "teleop")
    for _ in range(60):
        topics.send("/policy/action", up)
        topics.send("/teleop/joint_target", down)
        bridge.tick()
    assert topics.published["/minidual/mode"][-1] == "teleop"
    assert np.abs(topics.published["/joint_commands"][-1] - down).max() < 1e-6


def test_moveit_s_controllers_drive_by_joint_names(bridge, topics) -> None:
    topics.send("/mode_switch", "moveit")
    goal = DUAL_PANDA.home + 0.03
    for _ in range(40):
        topics.waiting["/moveit/joint_commands"].append(
            SimpleNamespace(name=list(DUAL_PANDA.joint_names), position=goal.tolist()),
        )
        bridge.tick()
    assert np.abs(topics.published["/joint_commands"][-1] - goal).max() < 1e-6


@pytest.mark.parametrize(
    ("topic", "data", "said"),
    [
        ("/mode_switch", "fly", "no mode 'fly'; there are moveit, teleop, policy, hold, recover"),
        ("/teleop/joint_target", [0.0], "/teleop/joint_target: 1 numbers; send 14"),
        ("/teleop/joint_target", DUAL_PANDA.q_upper + 1.0, "teleop: "),
        ("/policy/action", [float("nan")] * 14, "policy: "),
    ],
)
def test_what_is_not_carried_out_is_said(bridge, topics, topic: str, data: Any, said: str) -> None:
    topics.send(topic, data)
    ticks(bridge, 2)
    (line,) = topics.published["/minidual/refusals"]
    assert said in line
    assert bridge.counts.complaints_n == 1


def test_a_reflex_is_said_and_a_request_ends_it(bridge, topics) -> None:
    topics.send("/mode_switch", "teleop")
    ticks(bridge, 5)
    bridge._stack.fail(RuntimeError("the camera broke"))
    ticks(bridge, 30)
    (reflex,) = bridge.counts.reflexes
    assert reflex in "".join(topics.published["/minidual/refusals"])
    topics.send("/mode_switch", "teleop")
    bridge.tick()
    assert "may not drive" in topics.published["/minidual/refusals"][-1]
    topics.send("/mode_switch", "recover")
    ticks(bridge, 5)
    topics.send("/mode_switch", "teleop")
    ticks(bridge, 30)
    assert topics.published["/minidual/mode"][-1] == "teleop"
