"""Episodes of ALOHA: one HDF5 file each, without timestamps, names or a rate.

Layout: `observations/qpos`, `action`, optional `observations/qvel` and `observations/effort`, and
`observations/images/<camera>`, as pictures or as JPEG bytes padded to one length.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np

from minidual.demos.data.source import DataEpisode, EpisodeReading, Image
from minidual.demos.episode import is_unsafe
from minidual.demos.faults import EpisodeFault

RATE_HZ = 50.0
"""ALOHA's own; its files do not tell."""
_JOINTS = (
    "waist",
    "shoulder",
    "elbow",
    "forearm_roll",
    "wrist_angle",
    "wrist_rotate",
    "gripper",
)
NAMES = tuple(f"{side}_{joint}" for side in ("left", "right") for joint in _JOINTS)
_STATE = "observations/qpos"
_IMAGES = "observations/images"


def is_aloha(file: h5py.File) -> bool:
    """Return whether an open file has ALOHA's layout, and not this program's."""
    return _STATE in file and "action" in file and "schema_version" not in file.attrs


def read_aloha(file: h5py.File, path: Path) -> EpisodeReading:
    """Return the episode of an open file."""
    faults: list[EpisodeFault] = []
    state = _rows(file, _STATE, faults)
    action = _rows(file, "action", faults)
    effort = _rows(file, "observations/effort", faults) if "observations/effort" in file else None
    if state is None or action is None:
        return EpisodeReading(path.name, None, tuple(faults))
    if len(state) != len(action):
        detail = f"{_STATE} has {len(state)} rows, action {len(action)}"
        return EpisodeReading(path.name, None, (EpisodeFault("field_wrong", detail),))
    cameras: dict[str, tuple[int, int]] = {}
    for camera, dataset in _cameras(file).items():
        size = _picture_size(dataset)
        if size is None or len(dataset) != len(state):
            shape = f"{dataset.dtype} {dataset.shape}"
            detail = f"{_IMAGES}/{camera} is {shape}; expected {len(state)} pictures"
            faults.append(EpisodeFault("field_wrong", detail))
            continue
        cameras[camera] = size
    rate_hz = float(file.attrs.get("fps", RATE_HZ))
    episode = DataEpisode(
        name=path.name,
        rate_hz=rate_hz,
        times_s=np.arange(len(state)) / rate_hz,
        state=state,
        action=action,
        state_names=_names("state", state.shape[1]),
        action_names=_names("action", action.shape[1]),
        cameras=cameras,
        effort=effort,
        facts={"sim": bool(file.attrs.get("sim", False))},
    )
    return EpisodeReading(path.name, episode, tuple(faults))


def aloha_pictures(file: h5py.File, camera: str) -> Image:
    """Return the pictures (T, H, W, 3) of a camera of an open file, which must exist."""
    dataset = _cameras(file)[camera]
    if dataset.ndim == 4:
        return np.asarray(dataset[()], dtype=np.uint8)
    pictures = [cv2.imdecode(np.asarray(row, np.uint8), cv2.IMREAD_COLOR) for row in dataset[()]]
    height, width = _picture_size(dataset) or (1, 1)
    black = np.zeros((height, width, 3), np.uint8)  # in place of damaged bytes: a check names them
    shown = [black if bgr is None else bgr[..., ::-1] for bgr in pictures]
    return np.asarray(np.stack(shown), dtype=np.uint8)


def _rows(file: h5py.File, key: str, faults: list[EpisodeFault]) -> np.ndarray | None:
    dataset = file.get(key)
    if not isinstance(dataset, h5py.Dataset) or dataset.ndim != 2 or is_unsafe(dataset):
        faults.append(EpisodeFault("field_wrong", f"{key} is no table of ticks and joints"))
        return None
    if not np.issubdtype(dataset.dtype, np.number):
        faults.append(EpisodeFault("field_wrong", f"{key} holds {dataset.dtype}, not numbers"))
        return None
    return np.asarray(dataset[()], dtype=float)


def _cameras(file: h5py.File) -> Mapping[str, Any]:
    group = file.get(_IMAGES)
    if not isinstance(group, h5py.Group):
        return {}
    return {
        name: dataset
        for name, dataset in group.items()
        if isinstance(dataset, h5py.Dataset) and not is_unsafe(dataset)
    }


def _picture_size(dataset: Any) -> tuple[int, int] | None:
    if dataset.dtype != np.uint8:
        return None
    if dataset.ndim == 4 and dataset.shape[3] == 3:
        return dataset.shape[1], dataset.shape[2]
    if dataset.ndim == 2 and len(dataset):
        picture = cv2.imdecode(np.asarray(dataset[0]), cv2.IMREAD_COLOR)
        return None if picture is None else (picture.shape[0], picture.shape[1])
    return None


def _names(word: str, count: int) -> tuple[str, ...]:
    if count == len(NAMES):
        return NAMES
    return tuple(f"{word}_{k}" for k in range(count))
