"""The bridge: simulated arms under minidual's arbiter, in wall time, on topics."""

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.plant.protocol import Plant, openings_of
from minidual.robot.pair import Array
from minidual.ros2.bags.episode_topics import (
    GRIPPER_COMMANDS,
    GRIPPER_STATES,
    gripper_names,
)
from minidual.ros2.bridge.requests import Inbox
from minidual.ros2.bridge.topics import Topics
from minidual.ros2.names import JOINT_COMMANDS, JOINT_STATES

RATE_HZ = 100.0
"""Of joint states, commands and the arbiter."""
MODE = "/minidual/mode"
"""The source that drives, or "hold"; at each change and once a second."""
REFUSALS = "/minidual/refusals"
"""Why a message was not carried out."""
_LATE_S = 0.1
"""A bridge that is later than this gives up the lost time."""
_MODE_PERIOD_S = 1.0

Show = Callable[[Array], None]
"""Takes MuJoCo's positions (nq,) after each tick, for pictures."""


@dataclass
class BridgeCounts:
    """Counts of a bridge.

    Attributes:
        ticks_n: Joint states published.
        complaints_n: Messages that were not carried out.
        behind_s: Wall time given up, because the machine was too slow [s].
        reflexes: Messages of reflexes.
    """

    ticks_n: int
    complaints_n: int
    behind_s: float
    reflexes: list[str]


class Bridge:
    """Steps a plant in wall time and publishes it.

    Args:
        topics: Writers and readers.
        stack: Of the plant, whose arbiter ticks at RATE_HZ.
        show: Called after each tick.
        say: Shows a line to people.
    """

    def __init__(
        self,
        topics: Topics,
        stack: ControlStack[Plant],
        show: Callable[[], None] = lambda: None,
        say: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._topics = topics
        self._stack = stack
        self._plant = stack.plant
        self._robot = stack.plant.robot
        self._show = show
        self._say = say
        self._mode = ""
        self._refused_n = stack.refused_n
        self._mode_due_s = 0.0
        self._steps = round(1.0 / (RATE_HZ * self._plant.dt))
        self.counts = BridgeCounts(0, 0, 0.0, [])
        m = topics.messages
        topics.advertise(JOINT_STATES, m.JointState)
        for topic in (JOINT_COMMANDS, GRIPPER_STATES, GRIPPER_COMMANDS):
            topics.advertise(topic, m.Float64MultiArray)
        for topic in (MODE, REFUSALS):
            topics.advertise(topic, m.String)
        self._inbox = Inbox(topics, stack, self._robot)
        fingers = self._robot.finger_joint_names
        self._joint_names = [*self._robot.joint_names, *fingers]
        self._fingers_per_hand = len(fingers) // len(self._robot.sides)

    def run(self, stopped: Callable[[], bool], for_s: float) -> None:
        """Run until `stopped` or for so long [s]."""
        began_s = time.monotonic()
        due_s = began_s
        while not stopped() and time.monotonic() - began_s < for_s:
            self.tick()
            due_s += 1.0 / RATE_HZ
            wait_s = due_s - time.monotonic()
            if wait_s > 0.0:
                time.sleep(wait_s)
            elif wait_s < -_LATE_S:
                self.counts.behind_s -= wait_s
                due_s -= wait_s

    def tick(self) -> None:
        """Read requests, advance by one period, publish."""
        self._inbox.read()
        for _ in range(self._steps):
            try:
                self._stack.step()
            except ReflexError as reflex:
                self.counts.reflexes.append(reflex.message)
                self._complain([f"reflex: {reflex.message}"])
        self._complain(self._take_complaints())
        self._publish_states()
        self._publish_mode()
        self._show()
        self.counts.ticks_n += 1

    def _take_complaints(self) -> list[str]:
        refusals = self._stack.refused_since(self._refused_n)
        self._refused_n = self._stack.refused_n
        lines = [f"{refusal.source}: {refusal.name}: {refusal.detail}" for refusal in refusals]
        lines += self._inbox.complaints
        self._inbox.complaints = []
        return lines

    def _complain(self, lines: Sequence[str]) -> None:
        for line in lines:
            self.counts.complaints_n += 1
            self._topics.publish_text(REFUSALS, line)
            self._say(line)

    def _publish_states(self) -> None:
        topics = self._topics
        measurement = self._stack.measurement
        fingers = np.repeat(self._plant.fingers, self._fingers_per_hand)
        zeros = np.zeros(len(fingers))
        topics.publish(
            JOINT_STATES,
            topics.messages.JointState(
                topics.header(),
                self._joint_names,
                [*measurement.q.tolist(), *fingers.tolist()],
                [*measurement.v.tolist(), *zeros.tolist()],
                [*self._plant.tau.tolist(), *zeros.tolist()],
            ),
        )
        output = self._stack.output
        grippers = ",".join(gripper_names())
        joints = ",".join(self._robot.joint_names)
        topics.publish_floats(JOINT_COMMANDS, output.q_target, joints)
        topics.publish_floats(GRIPPER_STATES, openings_of(self._plant), grippers)
        topics.publish_floats(GRIPPER_COMMANDS, output.gripper, grippers)

    def _publish_mode(self) -> None:
        mode = self._stack.source or "hold"
        now_s = time.monotonic()
        if mode != self._mode or now_s >= self._mode_due_s:
            self._topics.publish_text(MODE, mode)
            self._mode = mode
            self._mode_due_s = now_s + _MODE_PERIOD_S


def come_to_rest(stack: ControlStack[Plant]) -> None:
    """Give the arms to no source, and step until they are still."""
    stack.request("hold")
    while stack.stopping or stack.arbiter.switching:
        with contextlib.suppress(ReflexError):
            stack.step()
