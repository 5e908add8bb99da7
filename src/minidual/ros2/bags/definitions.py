"""Definitions of the ROS 2 messages in our MCAP files, as their packages have them."""

_SEPARATOR = "=" * 80
_TIME = "int32 sec\nuint32 nanosec"
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id"
_DIMENSION = "string label\nuint32 size\nuint32 stride"
_LAYOUT = "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset"

JOINT_STATE = "sensor_msgs/msg/JointState"
IMAGE = "sensor_msgs/msg/Image"
FLOATS = "std_msgs/msg/Float64MultiArray"
TEXT = "std_msgs/msg/String"


def _definition(fields: str, **parts: str) -> str:
    """Return a definition with those of the messages inside; `a__b` stands for a/b."""
    sections = [fields]
    for name, text in parts.items():
        sections.append(f"MSG: {name.replace('__', '/')}\n{text}")
    return f"\n{_SEPARATOR}\n".join(sections)


DEFINITIONS: dict[str, str] = {
    JOINT_STATE: _definition(
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
        "float64[] effort",
        std_msgs__Header=_HEADER,
        builtin_interfaces__Time=_TIME,
    ),
    IMAGE: _definition(
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
        "uint8 is_bigendian\nuint32 step\nuint8[] data",
        std_msgs__Header=_HEADER,
        builtin_interfaces__Time=_TIME,
    ),
    FLOATS: _definition(
        "std_msgs/MultiArrayLayout layout\nfloat64[] data",
        std_msgs__MultiArrayLayout=_LAYOUT,
        std_msgs__MultiArrayDimension=_DIMENSION,
    ),
    TEXT: "string data",
}
"""{type: definition with those of the messages inside}."""
