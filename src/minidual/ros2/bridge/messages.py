"""ROS 2 messages as DDS types, with the type names of rmw.

Imports cyclonedds, which is the extra `minidual[ros2]`: `bridge.topics` imports this module late.
Annotations must stay types: cyclonedds reads them.
"""

import struct
from dataclasses import dataclass
from typing import Any, cast

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint8, uint32

_ENCAPSULATION = b"\x00\x01\x00\x00"
"""Of plain CDR, little endian."""


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """builtin_interfaces/msg/Time."""

    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """std_msgs/msg/Header."""

    stamp: Time
    frame_id: str


@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    """sensor_msgs/msg/JointState."""

    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    """sensor_msgs/msg/Image; `data` is bytes where we write."""

    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]

    def serialize(
        self,
        buffer: Any = None,
        endianness: Any = None,
        use_version_2: bool | None = None,
    ) -> bytes:
        """Return CDR. The library takes 30 times as long: it packs each byte by itself."""
        pixels = cast(bytes, self.data)
        stamp = self.header.stamp
        body = bytearray(struct.pack("<iI", stamp.sec, stamp.nanosec))
        body += _text(self.header.frame_id)
        _align(body)
        body += struct.pack("<II", self.height, self.width)
        body += _text(self.encoding)
        body.append(self.is_bigendian)
        _align(body)
        body += struct.pack("<II", self.step, len(pixels))
        return _ENCAPSULATION + bytes(body) + bytes(pixels)


@dataclass
class MultiArrayDimension(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayDimension_"):
    """std_msgs/msg/MultiArrayDimension."""

    label: str
    size: uint32
    stride: uint32


@dataclass
class MultiArrayLayout(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayLayout_"):
    """std_msgs/msg/MultiArrayLayout."""

    dim: sequence[MultiArrayDimension]
    data_offset: uint32


@dataclass
class Float64MultiArray(IdlStruct, typename="std_msgs::msg::dds_::Float64MultiArray_"):
    """std_msgs/msg/Float64MultiArray."""

    layout: MultiArrayLayout
    data: sequence[float64]


@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    """std_msgs/msg/String."""

    data: str


def _text(text: str) -> bytes:
    """Return a string in CDR: length with the final NUL, characters, NUL."""
    raw = text.encode() + b"\x00"
    return struct.pack("<I", len(raw)) + raw


def _align(body: bytearray) -> None:
    """Pad to the next multiple of 4 bytes, where the next number stands."""
    body += bytes(-len(body) % 4)
