"""The declarations of a LeRobot v3 dataset, in meta/info.json."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, cast

from minidual import durable
from minidual.durable import read_json
from minidual.errors import DataError
from minidual.robot.pair import Robot

STATE = "observation.state"
ACTION = "action"
IMAGE_PREFIX = "observation.images.cam_"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
SOURCES_FILE = "meta/minidual_sources.json"
"""Lists the recordings of a dataset; only datasets of this program have it."""

FPS_MAX = 1e5
PIXELS_MAX = 4096
ROWS_MAX = 10_000_000
"""Limits of the rate, a picture's sides and a dataset's rows, checked before memory is taken."""

REMEDY = (
    "record and convert again, the finished recording is kept beside it: "
    "minidual teleop-record --force"
)
OTHER_REMEDY = (
    "copy or record the dataset again; `minidual data check FOLDER` names what is wrong with it"
)
_CONVERTER = (
    "convert it with LeRobot: python -m lerobot.scripts.convert_dataset_v21_to_v30 --repo-id=NAME"
)
_COUNTED = ("timestamp", "frame_index", "episode_index", "index", "task_index")
"""Columns that every dataset has."""
_CHANNELS = (1, 3, 4)


class CameraFeature(NamedTuple):
    """How a camera's pictures are stored: as "video", or as "image" in the tables."""

    height: int
    width: int
    stored: str


class DatasetInfo(NamedTuple):
    """Content of meta/info.json.

    Attributes:
        names, action_names: Entries of states and of actions.
        cameras: By name, see `camera_name`.
        unread: What else the dataset holds, such as depth or a third vector.
        robot: Type of the robot, or "".
    """

    version: str
    fps: float
    frames_n: int
    episodes_n: int
    names: tuple[str, ...]
    action_names: tuple[str, ...]
    cameras: dict[str, CameraFeature]
    unread: tuple[str, ...]
    robot: str


def signal_key(name: str) -> str:
    """Return the feature of a recorded signal (`schema.SIGNALS`)."""
    return f"observation.{name}"


def camera_key(camera: str) -> str:
    """Return a camera's feature: "observation.images.cam_high" for "high".

    A camera of another dataset bears the full name of its feature.
    """
    return camera if "." in camera else IMAGE_PREFIX + camera


def camera_name(key: str) -> str:
    """Return the camera of a feature; the inverse of `camera_key`."""
    return key.removeprefix(IMAGE_PREFIX)


def state_names(robot: Robot) -> tuple[str, ...]:
    """Return the entries of states and actions here: joint names, then gripper names."""
    return (*robot.joint_names, *(f"{side}_gripper" for side in robot.sides))


def is_own(root: Path) -> bool:
    """Return whether this program made the dataset."""
    return (root / SOURCES_FILE).is_file()


def remedy_of(root: Path) -> str:
    """Return the remedy for a damaged dataset."""
    return REMEDY if is_own(root) else OTHER_REMEDY


def reading(source: Path | str, root: Path) -> Any:
    """Return the context that turns an error of a dataset's damaged content into DataError."""
    return durable.reading(source, remedy_of(root))


def read_info(root: Path) -> DatasetInfo:
    """Return the declarations of a dataset.

    Raises:
        DataError: It is missing or damaged, or holds what this program does not read.
    """
    path = root / "meta" / "info.json"
    if not path.is_file():
        raise DataError(
            f"no LeRobot dataset at {root} (meta/info.json is missing)",
            remedy="name the folder of a dataset on this machine; nothing is downloaded",
        )
    with reading(path, root):
        record = read_json(path)
        features = record["features"]
        version = str(record["codebase_version"])
        if not version.startswith("v3"):
            raise DataError(
                f"{root} is a LeRobot dataset of version {version}; this program reads v3",
                remedy=_CONVERTER,
            )
        refuse = partial(_refuse, root)
        _require_vectors(features, refuse)
        cameras, unread = _cameras(features)
        info = DatasetInfo(
            version=version,
            fps=float(record["fps"]),
            frames_n=int(record["total_frames"]),
            episodes_n=int(record["total_episodes"]),
            names=entry_names("state", features[STATE]),
            action_names=entry_names("action", features[ACTION]),
            cameras=cameras,
            unread=unread,
            robot=str(record.get("robot_type") or ""),
        )
        _check_bounds(info)
        _check_paths(record, info, refuse)
    return info


def _refuse(root: Path, reason: str, remedy: str) -> NoReturn:
    raise DataError(f"{root}: {reason}", remedy=remedy)


def _require_vectors(features: Mapping[str, Any], refuse: Any) -> None:
    """Refuse a dataset without a state or an action that is a vector."""
    for key in (STATE, ACTION):
        if key not in features:
            refuse(
                f"the dataset has no feature '{key}'; there are {', '.join(features) or 'none'}",
                f"policies here read a state and give an action: record one, or rename a feature "
                f"to {key}",
            )
        shape = list(features[key]["shape"])
        if len(shape) != 1:
            refuse(
                f"'{key}' has the shape {shape}; policies here take one row of numbers a tick",
                "flatten it, and record or write the dataset again",
            )


def entry_names(word: str, feature: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of a vector's entries.

    LeRobot writes them as a list, as {"motors": [...]}, as {name: index} or not at all; without a
    name for each entry they are `word` and a number.
    """
    count = int(feature["shape"][0])
    names = _flat(feature.get("names"))
    if len(names) != count or len(set(names)) != count:
        return tuple(f"{word}_{k}" for k in range(count))
    return tuple(names)


def _flat(names: Any) -> list[str]:
    if isinstance(names, Mapping):
        groups = cast(Mapping[str, Any], names)
        if all(isinstance(value, int) for value in groups.values()):
            return sorted(map(str, groups), key=lambda name: groups[name])
        members = {group: _flat(inner) for group, inner in groups.items()}
        flat = [name for inner in members.values() for name in inner]
        if len(set(flat)) == len(flat):
            return flat
        return [f"{group}.{name}" for group, inner in members.items() for name in inner]
    if isinstance(names, Sequence) and not isinstance(names, str):
        return [str(name) for name in cast(Sequence[Any], names)]
    return []


def _cameras(
    features: Mapping[str, Mapping[str, Any]],
) -> tuple[dict[str, CameraFeature], tuple[str, ...]]:
    """Return the colour cameras and the other pictures, in words."""
    cameras: dict[str, CameraFeature] = {}
    unread: list[str] = []
    for key, feature in features.items():
        if key in (STATE, ACTION, *_COUNTED):
            continue
        stored = str(feature["dtype"])
        if stored not in ("video", "image"):
            unread.append(f"{key} ({stored} {list(feature['shape'])})")
            continue
        height, width, channels = picture_shape(feature)
        if channels != 3 or _is_depth(feature):
            unread.append(f"{key} (pictures without colour)")
        elif "." not in key:
            unread.append(f"{key} (pictures are features named observation.images.NAME)")
        else:
            cameras[camera_name(key)] = CameraFeature(height, width, stored)
    return cameras, tuple(unread)


def picture_shape(feature: Mapping[str, Any]) -> tuple[int, int, int]:
    """Return height, width and channels of a picture, whose channels may stand first or last."""
    first, middle, last = (int(n) for n in feature["shape"])
    if last in _CHANNELS and first in _CHANNELS:
        names = _flat(feature.get("names"))
        is_first = bool(names) and names[0].startswith("c")
    else:
        is_first = first in _CHANNELS
    return (middle, last, first) if is_first else (first, middle, last)


def _is_depth(feature: Mapping[str, Any]) -> bool:
    facts = cast(Mapping[str, Any], feature.get("info") or {})
    return any(bool(value) for name, value in facts.items() if name.endswith("is_depth_map"))


def _check_bounds(info: DatasetInfo) -> None:
    """Raise ValueError for declarations that no dataset can have."""
    rate_ok = 0.0 < info.fps < FPS_MAX
    count_ok = 0 <= info.frames_n <= ROWS_MAX
    if not (rate_ok and count_ok):
        raise ValueError(f"fps {info.fps:g} or {info.frames_n} frames is out of bounds")
    for camera, feature in info.cameras.items():
        if not all(0 < n <= PIXELS_MAX for n in (feature.height, feature.width)):
            raise ValueError(f"camera '{camera}' has a size outside 1 to {PIXELS_MAX} pixels")


def _check_paths(record: Mapping[str, Any], info: DatasetInfo, refuse: Any) -> None:
    """Refuse other places of tables and videos than LeRobot's own."""
    has_videos = any(camera.stored == "video" for camera in info.cameras.values())
    for name, expected, is_used in (
        ("data_path", DATA_PATH, "data_path" in record),
        ("video_path", VIDEO_PATH, has_videos),
    ):
        if is_used and record[name] != expected:
            refuse(
                f"{name} is {record[name]!r:.80}; this program reads {expected}",
                "write the dataset with LeRobot's own layout",
            )
