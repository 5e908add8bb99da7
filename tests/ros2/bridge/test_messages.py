"""Messages on the wire: ROS 2's type names, plain CDR, as an independent reader has them."""

from __future__ import annotations

import pytest

pytest.importorskip("cyclonedds")

from cyclonedds.idl import IdlStruct
from rosbags.typesys import Stores, get_typestore

from minidual.errors import EnvironmentMissingError, UsageError
from minidual.ros2.bridge import messages as m
from minidual.ros2.bridge.topics import Topics, dds_name, domain_id

ROS = get_typestore(Stores.ROS2_JAZZY)
HEADER = m.Header(m.Time(1_700_000_000, 123_456_789), "camera_high_optical_frame")
PIXELS = bytes(range(256)) * 3
SAMPLES = {
    "sensor_msgs/msg/JointState": m.JointState(
        HEADER,
        ["left_panda_joint1", "b"],
        [0.1, -2.5e-300],
        [1.0, 2.0],
        [],
    ),
    "sensor_msgs/msg/Image": m.Image(HEADER, 16, 16, "rgb8", 0, 48, PIXELS),
    "std_msgs/msg/Float64MultiArray": m.Float64MultiArray(
        m.MultiArrayLayout([m.MultiArrayDimension("joints", 2, 2)], 0),
        [0.25, 1e9],
    ),
    "std_msgs/msg/String": m.String("teleop"),
}


@pytest.mark.parametrize("kind", SAMPLES)
def test_the_type_name_is_the_one_that_ros_2_gives(kind: str) -> None:
    package, folder, name = kind.split("/")
    expected = f"{package}::{folder}::dds_::{name}_"
    assert SAMPLES[kind].__idl_typename__.replace(".", "::") == expected


@pytest.mark.parametrize("kind", SAMPLES)
def test_rosbags_reads_the_bytes(kind: str) -> None:
    sample = SAMPLES[kind]
    raw = sample.serialize(use_version_2=False)
    assert raw[:4] == b"\x00\x01\x00\x00"
    read = ROS.deserialize_cdr(raw, kind)
    if kind == "sensor_msgs/msg/JointState":
        assert (list(read.name), list(read.position)) == (sample.name, sample.position)
        assert (read.header.stamp.sec, read.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    elif kind == "sensor_msgs/msg/Image":
        assert bytes(read.data) == PIXELS
        assert (read.width, read.step, read.encoding) == (16, 48, "rgb8")
        assert read.header.frame_id == HEADER.frame_id
    else:
        assert list(read.data) == list(sample.data)


@pytest.mark.parametrize("kind", SAMPLES)
def test_bytes_of_ros_are_read(kind: str) -> None:
    sample = SAMPLES[kind]
    raw = bytes(
        ROS.serialize_cdr(ROS.deserialize_cdr(sample.serialize(use_version_2=False), kind), kind)
    )
    read = type(sample).deserialize(raw)
    values = PIXELS if kind == "sensor_msgs/msg/Image" else None
    if values is not None:
        assert bytes(read.data) == values
    else:
        assert read == sample


@pytest.mark.parametrize("frame", ["", "a", "abc", "abcd"])
def test_our_packing_of_pictures_is_the_library_s(frame: str) -> None:
    image = m.Image(m.Header(m.Time(-1, 2), frame), 2, 1, "rgb8", 0, 3, bytes(6))
    general = IdlStruct.serialize(image, use_version_2=False)
    assert general.startswith(image.serialize())
    assert len(general) - len(image.serialize()) < 4  # the library pads the end


def test_topics_have_the_prefix_of_ros_2() -> None:
    assert dds_name("/joint_states") == "rt/joint_states"


def test_the_domain_is_that_of_ros(monkeypatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert domain_id(None) == 0
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert domain_id(None) == 42
    assert domain_id(7) == 7
    monkeypatch.setenv("ROS_DOMAIN_ID", "-1")
    with pytest.raises(UsageError, match="'-1'; it must be from 0 to 232"):
        domain_id(None)
    with pytest.raises(UsageError, match="'233'"):
        domain_id(233)


def test_without_the_library_the_extra_is_named(monkeypatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "cyclonedds.domain", None)
    with pytest.raises(EnvironmentMissingError, match=r"pip install 'minidual\[ros2\]'"):
        Topics(0)
