"""Episodes as MCAP: equal to the bit in a reader of others, and back; strange files are refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from minidual.cli.app import run_command_line
from minidual.config.scene import RobotConfig
from minidual.demos.episode import Episode, read_episode
from minidual.errors import DataError, UsageError
from minidual.robot.pair import DUAL_PANDA, robot_from
from minidual.ros2.bags.definitions import DEFINITIONS, FLOATS, IMAGE, JOINT_STATE
from minidual.ros2.bags.export import export_episode
from minidual.ros2.bags.load import import_file
from minidual.ros2.bags.mcap_files import McapWriter, read_messages, stamp
from minidual.stages.registry import STAGES, TOOLS
from tests.support import data_samples

TICKS = 12
ARRAYS = ("qpos", "qvel", "gripper", "action", "action_gripper", "timestamps", "image_timestamps")


@pytest.fixture(scope="module")
def episode(tmp_path_factory: pytest.TempPathFactory) -> Episode:
    """Times that no nanosecond holds, and readings in which every bit counts."""
    data = data_samples.arrays(TICKS, seed=5)
    data["timestamps"] = data["timestamps"] + np.arange(TICKS) * np.pi * 1e-11
    data["image_timestamps"] = data["timestamps"] + 0.003
    data["qpos"] = data["qpos"] * (1.0 + 2.0**-52)
    path = tmp_path_factory.mktemp("episodes") / "episode_000000.hdf5"
    return read_episode(data_samples.write(path, data, extra={"trial": 4}))


@pytest.fixture(scope="module")
def bag(episode: Episode, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "episode.mcap"
    messages_n = export_episode(episode, DUAL_PANDA, path)
    assert messages_n == 1 + TICKS * (5 + len(episode.images))
    return path


def foreign_messages(path: Path) -> dict[str, list]:
    """Return {topic: messages} as rosbags, which did not write the file, reads them."""
    from rosbags.highlevel import AnyReader

    found: dict[str, list] = {}
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append(message)
    return found


def test_an_independent_reader_has_the_joint_states_to_the_bit(episode, bag) -> None:
    messages = foreign_messages(bag)["/joint_states"]
    assert len(messages) == TICKS
    for tick, message in enumerate(messages):
        assert list(message.name) == list(DUAL_PANDA.joint_names)
        assert np.asarray(message.position).tobytes() == episode.qpos[tick].tobytes()
        assert np.asarray(message.velocity).tobytes() == episode.qvel[tick].tobytes()
        time_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        assert abs(time_ns * 1e-9 - episode.timestamps[tick]) < 1e-9


def test_an_independent_reader_has_pictures_and_commands(episode, bag) -> None:
    messages = foreign_messages(bag)
    for camera, frames in episode.images.items():
        pictures = messages[f"/camera_{camera}/image_raw"]
        assert len(pictures) == TICKS
        for tick, picture in enumerate(pictures):
            assert (picture.encoding, picture.step) == ("rgb8", 3 * picture.width)
            pixels = np.asarray(picture.data).reshape(picture.height, picture.width, 3)
            assert np.array_equal(pixels, frames[tick])
    for topic, rows in (
        ("/joint_commands", episode.action),
        ("/gripper_states", episode.gripper),
        ("/gripper_commands", episode.action_gripper),
    ):
        values = np.array([message.data for message in messages[topic]])
        assert values.tobytes() == rows.tobytes()


def test_it_comes_back_as_it_was(episode, bag, tmp_path) -> None:
    path = tmp_path / "back.hdf5"
    import_file(bag, path, DUAL_PANDA, fps=10.0, task="not this one")
    back = read_episode(path)
    assert back.meta == episode.meta
    for name in ARRAYS:
        assert getattr(back, name).tobytes() == getattr(episode, name).tobytes(), name
    for camera, frames in episode.images.items():
        assert np.array_equal(back.images[camera], frames)


def test_an_episode_without_velocities_and_pictures_comes_back(tmp_path) -> None:
    data = data_samples.arrays(4, cameras=())
    del data["qvel"]
    episode = read_episode(data_samples.write(tmp_path / "a.hdf5", data))
    export_episode(episode, DUAL_PANDA, tmp_path / "a.mcap")
    import_file(tmp_path / "a.mcap", tmp_path / "b.hdf5", DUAL_PANDA, fps=50.0, task="")
    back = read_episode(tmp_path / "b.hdf5")
    assert back.qvel is None
    assert back.image_timestamps is None
    assert back.qpos.tobytes() == episode.qpos.tobytes()


def test_the_episode_of_another_arm_is_refused(episode, tmp_path) -> None:
    ur5 = robot_from(RobotConfig(arm="ur5"))
    with pytest.raises(DataError, match="has 14 joints; the arms 'ur5' have 12"):
        export_episode(episode, ur5, tmp_path / "a.mcap")
    assert list(tmp_path.iterdir()) == []


def test_the_joints_of_another_arm_are_named(bag, tmp_path) -> None:
    ur5 = robot_from(RobotConfig(arm="ur5"))
    with pytest.raises(DataError, match="no joint left_shoulder_pan_joint; it has left_panda"):
        import_file(bag, tmp_path / "a.hdf5", ur5, fps=50.0, task="")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kept", [0, 60, 0.5, 0.95])
def test_a_cut_file_is_refused(bag, tmp_path, kept: float) -> None:
    content = bag.read_bytes()
    length = kept if isinstance(kept, int) else int(kept * len(content))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[:length])
    with pytest.raises(DataError):
        import_file(cut, tmp_path / "a.hdf5", DUAL_PANDA, fps=50.0, task="")
    assert [path.name for path in tmp_path.iterdir()] == ["cut.mcap"]


def test_a_file_that_is_none_is_refused(tmp_path) -> None:
    (tmp_path / "a.mcap").write_text("no bag")
    with pytest.raises(DataError, match="is no whole MCAP file"):
        list(read_messages(tmp_path / "a.mcap"))
    with pytest.raises(DataError, match="there is no file"):
        list(read_messages(tmp_path / "b.mcap"))


class Recorder:
    """A recording as `ros2 bag record` would make it of the bridge: topics at their own rates."""

    def __init__(self, path: Path, *, seconds: float, skip: tuple[str, ...] = ()) -> None:
        self.path = path
        self._skip = skip
        with McapWriter(path) as writer:
            for k in range(int(seconds * 100)):
                self._write(writer, k / 100)

    def _write(self, writer: McapWriter, t: float) -> None:
        start = 1_700_000_000.0  # wall time
        time_ns, now = stamp(start + t)
        header = {"stamp": now, "frame_id": ""}
        names = DUAL_PANDA.joint_names[::-1]
        q = (DUAL_PANDA.home + 0.1 * np.sin(t))[::-1]
        layout = {"dim": [], "data_offset": 0}
        messages = {
            "/joint_states": (
                JOINT_STATE,
                {
                    "header": header,
                    "name": ["extra_joint", *names],
                    "position": [9.0, *q],
                    "velocity": [],
                    "effort": [],
                },
            ),
            "/joint_commands": (
                FLOATS,
                {"layout": layout, "data": (DUAL_PANDA.home + 0.1 * np.sin(t + 0.1)).tolist()},
            ),
            "/gripper_states": (FLOATS, {"layout": layout, "data": [1.0, 1.0]}),
            "/gripper_commands": (FLOATS, {"layout": layout, "data": [1.0, 0.0]}),
        }
        if round(t * 100) % 3 == 0:
            pixels = np.full((4, 6, 3), round(t * 100) % 250, np.uint8)
            messages["/camera_high/image_raw"] = (
                IMAGE,
                {
                    "header": header,
                    "height": 4,
                    "width": 6,
                    "encoding": "rgb8",
                    "is_bigendian": 0,
                    "step": 20,
                    "data": np.pad(pixels.reshape(4, 18), ((0, 0), (0, 2))).tobytes(),
                },
            )
        for topic, (kind, content) in messages.items():
            if topic not in self._skip:
                writer.write(topic, kind, time_ns, content)


def test_a_recording_of_others_is_sampled_and_joints_are_found_by_name(tmp_path) -> None:
    Recorder(tmp_path / "a.mcap", seconds=1.0)
    meta = import_file(
        tmp_path / "a.mcap",
        tmp_path / "a.hdf5",
        DUAL_PANDA,
        fps=50.0,
        task="wave",
    )
    back = read_episode(tmp_path / "a.hdf5")
    assert (meta.cameras, meta.task, meta.success) == (("high",), "wave", False)
    assert len(back) == 50  # up to the last picture, at 0.99 s
    t = np.arange(50) / 50.0
    expected = DUAL_PANDA.home + 0.1 * np.sin(t)[:, None]
    assert np.abs(back.qpos - expected).max() < 0.1 * 0.011  # one period of the joint states
    assert back.images["high"].shape == (50, 4, 6, 3)
    assert np.array_equal(back.images["high"][5], np.full((4, 6, 3), 9))  # of 0.09 s, at 0.10 s


@pytest.mark.parametrize("topic", ["/joint_commands", "/gripper_states"])
def test_a_topic_that_is_missing_is_named(tmp_path, topic: str) -> None:
    Recorder(tmp_path / "a.mcap", seconds=0.2, skip=(topic,))
    with pytest.raises(DataError, match=f"no messages on {topic}; it has /camera_high"):
        import_file(tmp_path / "a.mcap", tmp_path / "a.hdf5", DUAL_PANDA, fps=50.0, task="")


def test_the_definitions_are_those_of_ros() -> None:
    """rosbags ships the definitions of ROS 2 Jazzy."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    ros = get_typestore(Stores.ROS2_JAZZY)
    for kind, text in DEFINITIONS.items():
        for name, fields in get_types_from_msg(text, kind).items():
            assert fields == ros.fielddefs[name], name


def test_the_commands_write_and_read(episode, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["data", "export", str(episode.path.parent), "--mcap", "bags", "--json"]
    assert run_command_line(words, STAGES, TOOLS) == 0
    (file,) = json.loads(capsys.readouterr().out)["files"]
    assert file == "bags/episode_000000.mcap"
    assert run_command_line(["data", "import", file, "--out", "a.hdf5"], STAGES, TOOLS) == 0
    assert read_episode("a.hdf5").qpos.tobytes() == episode.qpos.tobytes()
    assert run_command_line(["data", "import", file, "--out", "a.hdf5"], STAGES, TOOLS) == 2
    assert "a.hdf5 exists already" in capsys.readouterr().err
    assert run_command_line(["data", "export", file, "--mcap", "x.bag"], STAGES, TOOLS) == 2
    assert "--mcap x.bag must end in .mcap" in capsys.readouterr().err


def test_without_the_library_the_extra_is_named(monkeypatch, bag, tmp_path) -> None:
    import sys

    from minidual.errors import EnvironmentMissingError

    monkeypatch.setitem(sys.modules, "mcap_ros2.writer", None)
    monkeypatch.setitem(sys.modules, "mcap.reader", None)
    with pytest.raises(EnvironmentMissingError, match=r"pip install 'minidual\[ros2\]'"):
        McapWriter(tmp_path / "a.mcap")
    with pytest.raises(EnvironmentMissingError, match=r"pip install 'minidual\[ros2\]'"):
        list(read_messages(bag))


def test_an_existing_episode_is_kept(bag, tmp_path) -> None:
    (tmp_path / "a.hdf5").write_text("mine")
    with pytest.raises(UsageError, match="exists already"):
        import_file(bag, tmp_path / "a.hdf5", DUAL_PANDA, fps=50.0, task="")
    assert (tmp_path / "a.hdf5").read_text() == "mine"
