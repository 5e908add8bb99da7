"""An episode as one MCAP file."""

import json
from pathlib import Path

from minidual.demos.episode import Episode
from minidual.durable import replacing
from minidual.robot.pair import Array, Robot
from minidual.ros2.bags.definitions import FLOATS, IMAGE, JOINT_STATE, TEXT
from minidual.ros2.bags.episode_topics import (
    ENCODING,
    EPISODE,
    GRIPPER_COMMANDS,
    GRIPPER_STATES,
    TICK_TIMES,
    check_joints,
    gripper_names,
)
from minidual.ros2.bags.mcap_files import McapWriter, stamp
from minidual.ros2.names import JOINT_COMMANDS, JOINT_STATES, image_topic


def export_episode(episode: Episode, robot: Robot, path: Path) -> int:
    """Write an episode; a file at `path` is replaced. Return the number of messages.

    The log time of a tick's messages is its joint time; pictures are stamped with their own.

    Raises:
        DataError: The episode is of another robot.
        EnvironmentMissingError: The extra is not installed.
    """
    check_joints(episode, robot)
    messages_n = 1
    with replacing(path) as partial, McapWriter(partial) as writer:
        first_ns, _ = stamp(float(episode.timestamps[0]))
        attributes = episode.meta.to_attrs(len(episode))
        writer.write(EPISODE, TEXT, first_ns, {"data": json.dumps(attributes)})
        for tick in range(len(episode)):
            messages_n += _write_tick(writer, episode, robot, tick)
    return messages_n


def _write_tick(writer: McapWriter, episode: Episode, robot: Robot, tick: int) -> int:
    """Write one tick; return the number of its messages."""
    time_s = float(episode.timestamps[tick])
    time_ns, joint_stamp = stamp(time_s)
    image_time_s = time_s
    if episode.image_timestamps is not None:
        image_time_s = float(episode.image_timestamps[tick])
    times = {"joints": time_s}
    if episode.image_timestamps is not None:
        times["images"] = image_time_s
    velocity = [] if episode.qvel is None else episode.qvel[tick].tolist()
    writer.write(TICK_TIMES, FLOATS, time_ns, _floats(list(times), list(times.values())))
    joint_state = {
        "header": {"stamp": joint_stamp, "frame_id": ""},
        "name": list(robot.joint_names),
        "position": episode.qpos[tick].tolist(),
        "velocity": velocity,
        "effort": [],
    }
    writer.write(JOINT_STATES, JOINT_STATE, time_ns, joint_state)
    rows: dict[str, tuple[list[str], Array]] = {
        JOINT_COMMANDS: (list(robot.joint_names), episode.action[tick]),
        GRIPPER_STATES: (gripper_names(), episode.gripper[tick]),
        GRIPPER_COMMANDS: (gripper_names(), episode.action_gripper[tick]),
    }
    for topic, (labels, values) in rows.items():
        writer.write(topic, FLOATS, time_ns, _floats(labels, values.tolist()))
    _, image_stamp = stamp(image_time_s)
    for camera, frames in episode.images.items():
        height, width, channels = frames.shape[1:]
        image = {
            "header": {"stamp": image_stamp, "frame_id": f"camera_{camera}_optical_frame"},
            "height": height,
            "width": width,
            "encoding": ENCODING,
            "is_bigendian": 0,
            "step": width * channels,
            "data": frames[tick].tobytes(),
        }
        writer.write(image_topic(camera), IMAGE, time_ns, image)
    return 2 + len(rows) + len(episode.images)


def _floats(labels: list[str], values: list[float]) -> dict[str, object]:
    """Return a Float64MultiArray of one dimension, labelled with all names."""
    dimension = {"label": ",".join(labels), "size": len(values), "stride": len(values)}
    return {"layout": {"dim": [dimension], "data_offset": 0}, "data": values}
