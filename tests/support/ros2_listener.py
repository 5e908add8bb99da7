"""A second process on the bridge's topics: it leads an arm, and measures what it hears.

Run as a script with the DDS domain; it prints one JSON document.
"""

from __future__ import annotations

import json
import struct
import sys
import time
from typing import Any

import numpy as np

from minidual.ros2.bridge.topics import Topics
from minidual.ros2.names import (
    JOINT_COMMANDS,
    JOINT_STATES,
    MODE_SWITCH,
    TELEOP_TARGET,
    image_topic,
)

HEAR_S = 8.0
ARRIVE_S = 90.0
"""Longest wait for the arm: a busy machine simulates slowly."""
"""From when each camera has sent a picture."""
WAIT_S = 150.0
STEP_RAD = 0.15
CAMERAS = ("high", "left", "right")


class Listener:
    """Counts messages and their age on arrival, and asks the first joint to move."""

    def __init__(self, domain: int) -> None:
        self.topics = Topics(domain)
        m = self.topics.messages
        _read_stamps_only(m)
        self.topics.subscribe(JOINT_STATES, m.JointState, newest=False)
        self.topics.subscribe(JOINT_COMMANDS, m.Float64MultiArray, newest=False)
        for topic in ("/minidual/refusals", "/minidual/mode"):
            self.topics.subscribe(topic, m.String, newest=False)
        for camera in CAMERAS:
            self.topics.subscribe(image_topic(camera), m.Image, newest=False)
        self.topics.advertise(MODE_SWITCH, m.String)
        self.topics.advertise(TELEOP_TARGET, m.Float64MultiArray)
        self.ages_s: dict[str, list[float]] = {}
        self.modes: list[str] = []
        self.refusals: list[str] = []
        self.first: list[float] | None = None
        self.last: list[float] | None = None
        self.names: list[str] = []
        self.commands: list[list[float]] = []

    def hear(self) -> None:
        for message in self._take_stamped(JOINT_STATES):
            self.names = list(message.name)
            self.last = list(message.position)
            self.first = self.first or self.last
        for camera in CAMERAS:
            self._take_stamped(image_topic(camera))
        self.modes += [message.data for message in self.topics.take("/minidual/mode")]
        self.refusals += [message.data for message in self.topics.take("/minidual/refusals")]
        self.commands += [list(message.data) for message in self.topics.take(JOINT_COMMANDS)]

    def _take_stamped(self, topic: str) -> list[Any]:
        messages = self.topics.take(topic)
        now_s = time.time()
        for message in messages:
            sent_s = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
            self.ages_s.setdefault(topic, []).append(now_s - sent_s)
        return messages

    def lead(self) -> None:
        """Ask for the first joint 0.15 rad from where it was."""
        if self.first is None:
            return
        target = self.first[: len(self.first) - 4]
        target[0] += STEP_RAD
        self.topics.publish_floats(TELEOP_TARGET, np.array(target), "")

    @property
    def arrived(self) -> bool:
        """Whether the first joint is where it was led."""
        if self.first is None or self.last is None:
            return False
        return abs(self.last[0] - self.first[0] - STEP_RAD) < 0.01

    def document(self, heard_s: float) -> dict[str, Any]:
        rates = {topic: len(ages) / heard_s for topic, ages in self.ages_s.items()}
        tails = {topic: float(np.quantile(ages, 0.99)) for topic, ages in self.ages_s.items()}
        return {
            "rates_hz": rates,
            "p99_s": tails,
            "modes": self.modes,
            "refusals": self.refusals,
            "names": self.names,
            "moved_rad": (np.array(self.last) - np.array(self.first)).tolist(),
            "command": self.commands[-1],
        }


def _read_stamps_only(messages: Any) -> None:
    """Leave out a picture's pixels, which Python takes 5 ms to unpack."""

    def deserialize(kind: Any, data: bytes, *_: Any, **__: Any) -> Any:
        stamp = messages.Time(*struct.unpack_from("<iI", data, 4))
        return kind(messages.Header(stamp, ""), 0, 0, "", 0, 0, b"")

    messages.Image.deserialize = classmethod(deserialize)


def main(domain: int) -> None:
    listener = Listener(domain)
    waited_until_s = time.monotonic() + WAIT_S
    while len(listener.ages_s) < 1 + len(CAMERAS) and time.monotonic() < waited_until_s:
        listener.hear()
        time.sleep(0.002)
    listener.ages_s.clear()
    began_s = time.monotonic()
    asked = False
    led_s = 0.0
    now_s = 0.0
    while now_s < HEAR_S or (not listener.arrived and now_s < ARRIVE_S):
        listener.hear()
        now_s = time.monotonic() - began_s
        if not asked and now_s > 0.5:
            listener.topics.publish_text(MODE_SWITCH, "fly")
            listener.topics.publish_floats(TELEOP_TARGET, np.zeros(3), "")
            listener.topics.publish_text(MODE_SWITCH, "teleop")
            asked = True
        if now_s > 1.5 and now_s - led_s > 0.02:
            listener.lead()
            led_s = now_s
        time.sleep(0.001)
    print(json.dumps(listener.document(time.monotonic() - began_s)))


if __name__ == "__main__":
    main(int(sys.argv[1]))
