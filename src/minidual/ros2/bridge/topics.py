"""Publish and subscribe under the names that ROS 2 gives its topics in DDS."""

import os
import time
from typing import Any

import numpy as np

from minidual.errors import EnvironmentMissingError, UsageError
from minidual.robot.pair import Array

_PREFIX = "rt"
"""Prefix that rmw gives a topic's name: `/joint_states` is `rt/joint_states` in DDS."""
_DEPTH = 10
_DOMAIN_MAX = 232
_NANOSECONDS = 1_000_000_000
_BLOCKING_MAX_S = 0.01
"""Longest wait of a reliable writer for a slow reader."""


def dds_name(topic: str) -> str:
    """Return the name in DDS of a topic of ROS 2."""
    return f"{_PREFIX}{topic}"


def domain_id(typed: int | None) -> int:
    """Return the DDS domain: typed, else ROS_DOMAIN_ID, else 0.

    Raises:
        UsageError: It is no number from 0 to 232.
    """
    text = str(typed) if typed is not None else os.environ.get("ROS_DOMAIN_ID", "0")
    if not text.isdigit() or int(text) > _DOMAIN_MAX:
        raise UsageError(f"the DDS domain is '{text}'; it must be from 0 to {_DOMAIN_MAX}")
    return int(text)


def now_stamp() -> tuple[int, int]:
    """Return the wall time: seconds and nanoseconds."""
    return divmod(time.time_ns(), _NANOSECONDS)


class Topics:
    """The bridge's writers and readers in one DDS domain.

    Raises:
        EnvironmentMissingError: cyclonedds is not installed.
    """

    def __init__(self, domain: int) -> None:
        try:
            from cyclonedds.domain import DomainParticipant

            from minidual.ros2.bridge import messages
        except ImportError as error:
            raise EnvironmentMissingError(
                "the bridge needs cyclonedds, which is not installed",
                remedy="pip install 'minidual[ros2]'",
            ) from error
        self.messages: Any = messages
        self._participant = DomainParticipant(domain)
        self._writers: dict[str, Any] = {}
        self._readers: dict[str, Any] = {}
        self._kinds: dict[str, type] = {}

    def advertise(self, topic: str, kind: type) -> None:
        """Add a writer: reliable and volatile, as a publisher of ROS 2 is by default."""
        from cyclonedds.pub import DataWriter

        self._writers[topic] = DataWriter(
            self._participant,
            self._topic(topic, kind),
            qos=_qos(reliable=True, depth=_DEPTH),
        )

    def subscribe(self, topic: str, kind: type, *, newest: bool) -> None:
        """Add a reader.

        Args:
            topic: Of ROS 2.
            kind: Message class.
            newest: Whether only the newest message counts. It then also hears best-effort writers.
        """
        from cyclonedds.sub import DataReader

        self._kinds[topic] = kind
        self._readers[topic] = DataReader(
            self._participant,
            self._topic(topic, kind),
            qos=_qos(reliable=not newest, depth=1 if newest else _DEPTH),
        )

    def publish(self, topic: str, message: Any) -> None:
        """Write a message."""
        self._writers[topic].write(message)

    def publish_floats(self, topic: str, values: Array, label: str) -> None:
        """Write a Float64MultiArray of one dimension."""
        m = self.messages
        size = len(values)
        layout = m.MultiArrayLayout([m.MultiArrayDimension(label, size, size)], 0)
        self.publish(topic, m.Float64MultiArray(layout, np.asarray(values, dtype=float).tolist()))

    def publish_text(self, topic: str, text: str) -> None:
        """Write a String."""
        self.publish(topic, self.messages.String(text))

    def take(self, topic: str) -> list[Any]:
        """Return the messages that came since the last call, oldest first."""
        samples = self._readers[topic].take(N=_DEPTH)
        kind = self._kinds[topic]
        # A writer that leaves sends a sample without content.
        return [sample for sample in samples if isinstance(sample, kind)]

    def header(self, frame: str = "") -> Any:
        """Return a Header stamped now."""
        seconds, nanoseconds = now_stamp()
        return self.messages.Header(self.messages.Time(seconds, nanoseconds), frame)

    def close(self) -> None:
        """Leave the domain."""
        self._writers.clear()
        self._readers.clear()
        del self._participant

    def _topic(self, topic: str, kind: type) -> Any:
        from cyclonedds.topic import Topic

        return Topic(self._participant, dds_name(topic), kind)


def _qos(*, reliable: bool, depth: int) -> Any:
    from cyclonedds.core import Policy, Qos
    from cyclonedds.util import duration

    reliability: Any = Policy.Reliability.BestEffort
    if reliable:
        blocking = duration(milliseconds=1000.0 * _BLOCKING_MAX_S)
        reliability = Policy.Reliability.Reliable(blocking)
    return Qos(
        reliability,
        Policy.Durability.Volatile,
        Policy.History.KeepLast(depth),
        # ROS 2 speaks the first representation of CDR.
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
