"""Incoming messages: joint targets of the sources, and requests for a mode."""

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from minidual.control.commands import HOLD, SOURCES, JointCommand
from minidual.control.stack import ControlStack
from minidual.errors import MinidualError
from minidual.plant.protocol import Plant
from minidual.robot.pair import GRIPPERS_N, SIDES, Array, Robot
from minidual.ros2.names import MODE_SWITCH, MOVEIT_COMMANDS, POLICY_ACTION, TELEOP_TARGET

STREAMS = {"teleop": TELEOP_TARGET, "policy": POLICY_ACTION}
"""{source: topic} of those that send arrays of joint targets."""
RECOVER = "recover"
"""Request that ends a reflex; the arms hold afterwards."""
MODES = (*SOURCES, HOLD, RECOVER)


class JointStateLike(Protocol):
    """A sensor_msgs/msg/JointState."""

    name: Sequence[str]
    position: Sequence[float]


class Target(NamedTuple):
    """A joint target.

    Attributes:
        q: (n,) [rad].
        gripper: Openings (2,), 0 to 1.
    """

    q: Array
    gripper: Array


class BadMessageError(Exception):
    """A message that is no target; the text says why."""


def target_of_array(data: Sequence[float], robot: Robot, openings: Array) -> Target:
    """Return the target of n joints, or of n joints and the two openings.

    Args:
        data: As received.
        robot: The pair.
        openings: (2,), kept if the message has none.

    Raises:
        BadMessageError: It has another length.
    """
    values = np.array(data, dtype=float)
    if values.shape == (robot.dof,):
        return Target(values, openings)
    if values.shape == (robot.dof + GRIPPERS_N,):
        return Target(values[: robot.dof], values[robot.dof :])
    raise BadMessageError(
        f"{values.size} numbers; send {robot.dof} joint targets [rad], or {robot.dof + GRIPPERS_N}"
        " with the openings of both hands (0 closed to 1 open)",
    )


def target_of_joints(message: JointStateLike, robot: Robot, openings: Array) -> Target:
    """Return the target of a JointState, whose joints are found by name.

    A finger's position [m] is its hand's opening. Joints without a number are not commanded: all of
    the arms must have one.

    Raises:
        BadMessageError: An arm's joint is missing.
    """
    positions = {
        name: value
        for name, value in zip(message.name, message.position, strict=False)
        if not math.isnan(value)
    }
    missing = [name for name in robot.joint_names if name not in positions]
    if missing:
        raise BadMessageError(f"no position of {', '.join(missing)}")
    gripper = np.array(openings, dtype=float)
    leading, _ = robot.hand.finger_joints
    for hand, side in enumerate(SIDES):
        position_m = positions.get(f"{side}_{leading}")
        if position_m is not None:
            gripper[hand] = min(1.0, max(0.0, position_m / robot.hand.travel_m))
    return Target(np.array([positions[name] for name in robot.joint_names]), gripper)


class Inbox:
    """Passes the messages of the topics to the arbiter.

    Attributes:
        complaints: Why messages were ignored or refused, since they were taken last.
    """

    def __init__(self, topics: Any, stack: ControlStack[Plant], robot: Robot) -> None:
        self._topics = topics
        self._stack = stack
        self._robot = robot
        self._numbers = {source: itertools.count(1) for source in SOURCES}
        self.complaints: list[str] = []
        for topic in STREAMS.values():
            topics.subscribe(topic, topics.messages.Float64MultiArray, newest=True)
        topics.subscribe(MOVEIT_COMMANDS, topics.messages.JointState, newest=True)
        topics.subscribe(MODE_SWITCH, topics.messages.String, newest=False)

    def read(self) -> None:
        """Pass on everything that has come."""
        for message in self._topics.take(MODE_SWITCH):
            self._request(message.data.strip())
        openings = self._stack.output.gripper
        for source, topic in STREAMS.items():
            for message in self._topics.take(topic):
                try:
                    self._propose(source, target_of_array(message.data, self._robot, openings))
                except BadMessageError as error:
                    self.complaints.append(f"{topic}: {error}")
        for message in self._topics.take(MOVEIT_COMMANDS):
            try:
                self._propose("moveit", target_of_joints(message, self._robot, openings))
            except BadMessageError as error:
                self.complaints.append(f"{MOVEIT_COMMANDS}: {error}")

    def _propose(self, source: str, target: Target) -> None:
        """Offer a target; the arbiter keeps its refusal."""
        stamp_s = self._stack.measurement.time_s
        number = next(self._numbers[source])
        self._stack.propose(source, JointCommand(target.q, target.gripper, stamp_s, number))

    def _request(self, mode: str) -> None:
        if mode not in MODES:
            self.complaints.append(f"{MODE_SWITCH}: no mode '{mode}'; there are {', '.join(MODES)}")
            return
        try:
            if mode == RECOVER:
                self._stack.recover()
            else:
                self._stack.request(mode)
        except MinidualError as error:
            self.complaints.append(f"{MODE_SWITCH}: {error.message}")
