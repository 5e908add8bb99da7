"""Another program leads, over UDP or a WebSocket."""

import time
from collections import Counter, deque
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np
from pydantic import ValidationError

from minidual.config.leading import NetworkConfig
from minidual.demos.leader import Features, Feedback, Leader, LeaderSample, LeaderSetup
from minidual.demos.leaders.network_door import Door, Parcel, UdpDoor
from minidual.demos.leaders.network_message import StateMessage, TargetMessage
from minidual.demos.leaders.network_websocket import WebSocketDoor
from minidual.demos.station import Button
from minidual.robot.pair import Array, Robot
from minidual.tasks.task import Trial

_REMEMBERED_N = 1000
"""Sequences that tell a duplicate from a late message."""


class Order:
    """Passes packets that are newer than all before them, and counts the others.

    Attributes:
        counts: {reason: messages dropped}.
    """

    def __init__(self, silence_max_s: float) -> None:
        self._silence_max_s = silence_max_s
        self._sender: str | None = None
        self._last_s = float("-inf")
        self._sequence = -1
        self._recent: deque[int] = deque(maxlen=_REMEMBERED_N)
        self.counts: Counter[str] = Counter()

    def admits(self, message: TargetMessage, now_s: float) -> bool:
        """Return whether a message that came at a time [s] is to be followed."""
        if message.sender != self._sender:
            if now_s - self._last_s < self._silence_max_s:
                self.counts["from another sender"] += 1
                return False
            self._sender = message.sender
            self._sequence = -1
            self._recent.clear()
        if message.sequence in self._recent:
            self.counts["duplicated"] += 1
            return False
        self._recent.append(message.sequence)
        if message.sequence < self._sequence:
            self.counts["late"] += 1
            return False
        self._sequence = message.sequence
        self._last_s = now_s
        return True


class NetworkLeader(Leader):
    """Follows the newest target that a program sends to a port, and answers with the state.

    Raises:
        EnvironmentMissingError: The port is taken, or the interface does not exist.
    """

    features: ClassVar[Features] = Features(
        targets="joints",
        buttons=tuple(Button),
        clutch=True,
        feedback=True,
        realtime=True,
    )
    usage: ClassVar[str] = (
        "network: another program sends targets to port teleop.network.port, over UDP or, with "
        "teleop.network.transport=websocket, over a WebSocket (docs/teleoperation.md)"
    )

    def __init__(self, robot: Robot, config: NetworkConfig) -> None:
        self._robot = robot
        self._silence_max_s = config.silence_max_s
        self._door: Door = _door(config)
        self.port = self._door.port
        self._order = Order(config.silence_max_s)
        self._sample: LeaderSample | None = None
        self._came_s = float("-inf")
        self._stamp_s = 0.0
        self._clock_offset_s = float("inf")
        self._state = _state(0.0, robot.home, np.ones(2), np.zeros(robot.dof), robot)

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        """Listen at the port."""
        return cls(setup.robot, setup.config.network)

    @property
    def hint(self) -> str:
        """How many messages were dropped, and why."""
        counts = self._order.counts
        dropped = ", ".join(f"{count} {reason}" for reason, count in sorted(counts.items()))
        return f"dropped messages: {dropped}" if dropped else ""

    @property
    def counts(self) -> dict[str, int]:
        """{reason: messages dropped}."""
        return dict(self._order.counts)

    def align(self, trial: Trial, q_follower: Array) -> None:
        """Answer with the posture of the arms; forget the last reading."""
        zeros = np.zeros(self._robot.dof)
        self._state = _state(0.0, q_follower, np.ones(2), zeros, self._robot)
        self._sample = None

    def read(self, now_s: float) -> LeaderSample | None:
        """Return the newest target; None once nothing has come for a while."""
        pressed: list[Button] = []
        for parcel in self._door.parcels():
            pressed += self._take(parcel)
        silent_s = time.monotonic() - self._came_s
        if self._sample is None or silent_s > self._silence_max_s:
            return None
        age_s = time.monotonic() - self._stamp_s - self._clock_offset_s
        return replace(self._sample, pressed=tuple(pressed), age_s=age_s)

    def _take(self, parcel: Parcel) -> tuple[Button, ...]:
        """Take a message; return its buttons if it is followed."""
        now_s = time.monotonic()
        try:
            message = TargetMessage.model_validate_json(parcel.data)
            sample = message.sample(self._robot)
        except (ValidationError, ValueError):
            self._order.counts["malformed"] += 1
            return ()
        if not self._order.admits(message, now_s):
            return ()
        self._answer(message.sequence, parcel)
        if sample is None:
            return message.pressed
        self._sample = sample
        self._came_s = now_s
        self._stamp_s = message.stamp_s
        # The fastest message tells the clocks apart; others are late by what they take longer.
        self._clock_offset_s = min(self._clock_offset_s, now_s - message.stamp_s)
        return message.pressed

    def _answer(self, sequence: int, parcel: Parcel) -> None:
        state = self._state.model_copy(update={"sequence": sequence})
        if not parcel.answer(state.model_dump_json()):
            self._order.counts["answers that could not be sent"] += 1

    def feedback(self, feedback: Feedback) -> None:
        """Keep the state for the next answer."""
        self._state = _state(
            feedback.stamp_s,
            feedback.q,
            feedback.openings,
            feedback.external_nm,
            self._robot,
        )

    def close(self) -> None:
        """Free the port."""
        self._door.close()


def _state(
    stamp_s: float, q: Array, openings: Array, external_nm: Array, robot: Robot
) -> StateMessage:
    return StateMessage(
        sequence=0,
        stamp_s=float(stamp_s),
        names=robot.joint_names,
        q=tuple(map(float, q)),
        openings=tuple(map(float, openings)),
        external_nm=tuple(map(float, external_nm)),
    )


def _door(config: NetworkConfig) -> Door:
    if config.transport == "websocket":
        return WebSocketDoor(config)
    return UdpDoor(config)
