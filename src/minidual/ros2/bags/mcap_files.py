"""Write and read MCAP files; the library is the extra `minidual[ros2]`."""

from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

from minidual.errors import DataError, EnvironmentMissingError
from minidual.ros2.bags.definitions import DEFINITIONS

NANOSECONDS = 1_000_000_000


class Message(NamedTuple):
    """One message of a file.

    Attributes:
        topic: Its topic.
        kind: Its type, such as "sensor_msgs/msg/Image".
        time_ns: When it was logged.
        content: Its fields as attributes.
    """

    topic: str
    kind: str
    time_ns: int
    content: Any


class McapWriter:
    """Writes messages of the types in DEFINITIONS, in a file that is finished on leaving.

    Raises:
        EnvironmentMissingError: The extra is not installed.
    """

    def __init__(self, path: Path) -> None:
        try:
            from mcap_ros2.writer import Writer
        except ImportError as error:
            raise _missing() from error
        self._stream = path.open("wb")
        self._writer = Writer(self._stream)
        self._schemas: dict[str, Any] = {}
        self._counts: dict[str, int] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self._writer.finish()
        self._stream.close()

    def write(self, topic: str, kind: str, time_ns: int, content: dict[str, Any]) -> None:
        """Add a message; `content` is {field: value}."""
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_msgdef(kind, DEFINITIONS[kind])
        sequence = self._counts.get(topic, 0)
        self._counts[topic] = sequence + 1
        self._writer.write_message(
            topic=topic,
            schema=self._schemas[kind],
            message=content,
            log_time=time_ns,
            publish_time=time_ns,
            sequence=sequence,
        )


def read_messages(path: Path) -> Iterator[Message]:
    """Yield the messages of a file by log time.

    Raises:
        DataError: It is no MCAP file, or is truncated.
        EnvironmentMissingError: The extra is not installed.
    """
    try:
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as error:
        raise _missing() from error
    if not path.is_file():
        raise DataError(f"there is no file {path}")
    try:
        with path.open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            for schema, channel, message, content in reader.iter_decoded_messages():
                kind = "" if schema is None else schema.name
                yield Message(channel.topic, kind, message.log_time, content)
    except Exception as error:  # the library raises anything for a damaged file
        raise DataError(f"{path} is no whole MCAP file: {error}") from error


def stamp(time_s: float) -> tuple[int, dict[str, int]]:
    """Return a time in nanoseconds, and as builtin_interfaces/Time."""
    time_ns = round(time_s * NANOSECONDS)
    seconds, nanoseconds = divmod(time_ns, NANOSECONDS)
    return time_ns, {"sec": seconds, "nanosec": nanoseconds}


def _missing() -> EnvironmentMissingError:
    return EnvironmentMissingError(
        "MCAP files need mcap-ros2-support, which is not installed",
        remedy="pip install 'minidual[ros2]'",
    )
