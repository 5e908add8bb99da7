"""An MCAP file as an episode: ours, or a recording of the same topics by `ros2 bag record`.

Our own files have one message of each topic a tick, so they come back as they were. Others are
sampled: at each tick the latest message of each topic counts.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minidual.demos.schema import EpisodeMeta
from minidual.demos.writer import EpisodeWriter
from minidual.errors import DataError
from minidual.robot.pair import GRIPPERS_N, Array, Robot
from minidual.ros2.bags.definitions import IMAGE
from minidual.ros2.bags.episode_topics import (
    ENCODING,
    EPISODE,
    GRIPPER_COMMANDS,
    GRIPPER_STATES,
    NEEDED,
    TICK_TIMES,
    camera_of,
)
from minidual.ros2.bags.mcap_files import NANOSECONDS, Message, read_messages
from minidual.ros2.names import JOINT_COMMANDS, JOINT_STATES

_LATE_MAX_S = 0.5
"""Longest time without a message of a topic, at which a recording is no episode."""


@dataclass
class _Recording:
    """Messages of a file, in order: log times [ns] and contents by topic."""

    path: Path
    attributes: Mapping[str, Any] | None = None
    times_ns: dict[str, list[int]] = field(default_factory=dict[str, list[int]])
    contents: dict[str, list[Any]] = field(default_factory=dict[str, list[Any]])

    def add(self, message: Message, content: Any) -> None:
        self.times_ns.setdefault(message.topic, []).append(message.time_ns)
        self.contents.setdefault(message.topic, []).append(content)

    @property
    def cameras(self) -> dict[str, str]:
        """{camera: topic}, in the order of the episode's attributes if it has them."""
        topics: dict[str, str] = {}
        for topic in self.contents:
            camera = camera_of(topic)
            if camera is not None:
                topics[camera] = topic
        return topics


def import_file(
    source: Path,
    target: Path,
    robot: Robot,
    *,
    fps: float,
    task: str,
) -> EpisodeMeta:
    """Write an MCAP file as an episode; return its metadata.

    Args:
        source: The MCAP file.
        target: The HDF5 file, which must not exist.
        robot: Whose joints are read, by name.
        fps: Rate [Hz] of an episode that is sampled from a recording of other programs.
        task: Its instruction.

    Raises:
        DataError: A topic is missing, or a message does not fit.
        UsageError: The target exists.
    """
    recording = _read(source, robot)
    missing = [topic for topic in NEEDED if topic not in recording.contents]
    if missing:
        present = ", ".join(sorted(recording.contents)) or "none"
        raise DataError(f"{source} has no messages on {', '.join(missing)}; it has {present}")
    if recording.attributes is None:
        meta = EpisodeMeta(
            fps=fps,
            task=task,
            seed=0,
            cameras=tuple(sorted(recording.cameras)),
            extra={"source": source.name},
        )
        ticks = _sampled(recording, meta)
    else:
        meta, ticks_n = EpisodeMeta.from_attrs(recording.attributes)
        ticks = _exact(recording, meta, ticks_n)
    with EpisodeWriter(target, meta) as writer:
        for images, values in ticks:
            writer.append(images=images, **values)
        writer.finish(success=meta.success)
        writer.publish()
    return meta


_Tick = tuple[dict[str, NDArray[np.uint8]], dict[str, Any]]


def _exact(recording: _Recording, meta: EpisodeMeta, ticks_n: int) -> Iterator[_Tick]:
    """Yield the ticks of a file of ours."""
    topics = {camera: recording.cameras.get(camera, "") for camera in meta.cameras}
    for topic in (*NEEDED, TICK_TIMES, *topics.values()):
        count = len(recording.contents.get(topic, ()))
        if count != ticks_n:
            raise DataError(f"{recording.path}: {count} messages on {topic} for {ticks_n} ticks")
    for tick in range(ticks_n):
        times = recording.contents[TICK_TIMES][tick]
        values: dict[str, Any] = {"timestamps": times[0]}
        if len(times) > 1:
            values["image_timestamps"] = times[1]
        values |= _arrays({topic: recording.contents[topic][tick] for topic in NEEDED})
        images = {camera: recording.contents[topic][tick] for camera, topic in topics.items()}
        yield images, values


def _sampled(recording: _Recording, meta: EpisodeMeta) -> Iterator[_Tick]:
    """Yield ticks at equal times, from when every topic has had a message to when one ends."""
    cameras = recording.cameras
    topics = (*NEEDED, *cameras.values())
    times_s = {
        topic: np.array(recording.times_ns[topic], dtype=float) / NANOSECONDS for topic in topics
    }
    begin_s = max(times[0] for times in times_s.values())
    end_s = min(times[-1] for times in times_s.values())
    for k in range(int((end_s - begin_s) * meta.fps) + 1):
        now_s = begin_s + k / meta.fps
        rows = {}
        for topic in topics:
            row = int(np.searchsorted(times_s[topic], now_s, side="right")) - 1
            late_s = now_s - times_s[topic][row]
            if late_s > _LATE_MAX_S:
                raise DataError(
                    f"{recording.path}: no message on {topic} for {late_s:.2f} s;"
                    f" at most {_LATE_MAX_S} s",
                )
            rows[topic] = row
        values = _arrays({topic: recording.contents[topic][rows[topic]] for topic in NEEDED})
        values["timestamps"] = now_s - begin_s
        images = {
            camera: recording.contents[topic][rows[topic]] for camera, topic in cameras.items()
        }
        yield images, values


def _arrays(contents: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arrays of a tick by field of the schema."""
    position, velocity = contents[JOINT_STATES]
    values = {
        "qpos": position,
        "gripper": contents[GRIPPER_STATES],
        "action": contents[JOINT_COMMANDS],
        "action_gripper": contents[GRIPPER_COMMANDS],
    }
    if velocity is not None:
        values["qvel"] = velocity
    return values


def _read(source: Path, robot: Robot) -> _Recording:
    recording = _Recording(source)
    for message in read_messages(source):
        topic = message.topic
        if topic == EPISODE:
            recording.attributes = _attributes(message, source)
        elif topic == JOINT_STATES:
            recording.add(message, _joints(message, robot, source))
        elif topic == JOINT_COMMANDS:
            recording.add(message, _row(message, robot.dof, source))
        elif topic in (GRIPPER_STATES, GRIPPER_COMMANDS):
            recording.add(message, _row(message, GRIPPERS_N, source))
        elif topic == TICK_TIMES:
            recording.add(message, [float(value) for value in message.content.data])
        elif camera_of(topic) is not None and message.kind == IMAGE:
            recording.add(message, _picture(message, source))
    return recording


def _attributes(message: Message, source: Path) -> Mapping[str, Any]:
    try:
        attributes = json.loads(message.content.data)
    except ValueError as error:
        raise DataError(f"{source}: {EPISODE} is no JSON: {error}") from error
    if not isinstance(attributes, dict):
        raise DataError(f"{source}: {EPISODE} is no JSON object")
    return attributes


def _joints(message: Message, robot: Robot, source: Path) -> tuple[Array, Array | None]:
    """Return positions and velocities of the robot's joints, in storage order."""
    rows = {name: row for row, name in enumerate(message.content.name)}
    absent = [name for name in robot.joint_names if name not in rows]
    if absent:
        present = ", ".join(rows) or "none"
        raise DataError(
            f"{source}: {JOINT_STATES} has no joint {absent[0]}; it has {present}",
            remedy="name the arm of the recording: --set robot.arm=NAME",
        )
    order = [rows[name] for name in robot.joint_names]
    position = np.array(message.content.position, dtype=float)[order]
    velocity = np.array(message.content.velocity, dtype=float)
    return position, velocity[order] if velocity.size else None


def _row(message: Message, length: int, source: Path) -> Array:
    values = np.array(message.content.data, dtype=float)
    if values.shape != (length,):
        raise DataError(
            f"{source}: {message.topic} has {values.size} numbers; it must have {length}"
        )
    return values


def _picture(message: Message, source: Path) -> NDArray[np.uint8]:
    """Return a picture (H, W, 3)."""
    image = message.content
    if image.encoding != ENCODING:
        raise DataError(
            f"{source}: {message.topic} is encoded as {image.encoding}; {ENCODING} is read",
        )
    pixels = np.frombuffer(bytes(image.data), dtype=np.uint8)
    rows = pixels.reshape(image.height, image.step)
    channels = len(ENCODING.removesuffix("8"))
    return rows[:, : image.width * channels].reshape(image.height, image.width, channels).copy()
