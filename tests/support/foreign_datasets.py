"""Datasets of other robots, made by LeRobot itself: small pictures, two short episodes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.late import late

lerobot_dataset = late("lerobot.datasets.lerobot_dataset")
video = late("lerobot.configs.video")

ARM = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
"""Joints of one arm of another maker."""
TOP = "observation.images.top"
SIZE = (32, 48)
TICKS = 24
EPISODES = 2


def vector(names: Any, count: int) -> dict[str, Any]:
    return {"dtype": "float32", "shape": (count,), "names": names}


def camera(*, stored: str = "video", channels_first: bool = False) -> dict[str, Any]:
    height, width = SIZE
    if channels_first:
        names = ["channels", "height", "width"]
        return {"dtype": stored, "shape": (3, height, width), "names": names}
    return {"dtype": stored, "shape": (height, width, 3), "names": ["height", "width", "channels"]}


def one_arm(**cameras: dict[str, Any]) -> dict[str, Any]:
    """Return the features of an arm whose joints bear LeRobot's older form of names."""
    names = {"motors": list(ARM)}
    return {
        "observation.state": vector(names, len(ARM)),
        "action": vector(names, len(ARM)),
        **(cameras or {TOP: camera()}),
    }


def motion(feature: Mapping[str, Any], episode: int, *, lead: float = 0.0) -> np.ndarray:
    """Return smooth values (TICKS, entries); the last entry closes and opens."""
    count = int(feature["shape"][0])
    t = np.linspace(0.0, 1.0, TICKS)[:, None]
    values = np.sin(2.0 * np.pi * (t + lead + 0.1 * np.arange(count) + 0.3 * episode))
    values[:, -1] = ((t > 0.3) & (t < 0.7)).ravel()
    return values.astype(np.float32)


def pictures(episode: int, index: int, *, flicker: bool = False) -> np.ndarray:
    """Return gradients (TICKS, H, W, 3) that drift."""
    height, width = SIZE
    row, column = np.mgrid[0:height, 0:width]
    frames = np.empty((TICKS, height, width, 3), np.uint8)
    for k in range(TICKS):
        frames[k, ..., 0] = 40 + 100 * row / height
        frames[k, ..., 1] = 60 + 40 * index + 60 * ((column + k) % width) / width
        frames[k, ..., 2] = 90 + 20 * episode
        if flicker and k % 2:
            frames[k] = frames[k] // 3
    return frames


def make(
    root: Path,
    features: dict[str, Any],
    *,
    fps: int = 20,
    flicker: bool = False,
    tasks: Sequence[str] = ("stack the cups",) * EPISODES,
) -> Path:
    """Write a dataset with these features, and an episode of each of `tasks`, at `root`."""
    videos = any(feature["dtype"] == "video" for feature in features.values())
    dataset = lerobot_dataset.LeRobotDataset.create(
        repo_id="somebody/cups",
        fps=fps,
        features=features,
        root=root,
        robot_type="so100_follower",
        use_videos=videos,
        video_backend="pyav",
        rgb_encoder=video.RGBEncoderConfig(vcodec="h264", preset="veryfast", pix_fmt="yuv444p"),
    )
    seen = [key for key, feature in features.items() if feature["dtype"] in ("video", "image")]
    for episode, task in enumerate(tasks):
        shown = {key: pictures(episode, seen.index(key), flicker=flicker) for key in seen}
        moved = {
            key: motion(features[key], episode, lead=0.02 if key == "action" else 0.0)
            for key in features
            if key not in seen
        }
        for tick in range(TICKS):
            frame = {key: frames[tick] for key, frames in shown.items()}
            for key in seen:
                if features[key]["shape"][0] == 3:
                    frame[key] = frame[key].transpose(2, 0, 1)
            frame |= {key: values[tick] for key, values in moved.items()}
            dataset.add_frame({**frame, "task": task})
        dataset.save_episode()
    dataset.finalize()
    return root


def change_info(root: Path, change: Any) -> None:
    """Let `change` alter what meta/info.json declares."""
    path = root / "meta" / "info.json"
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))
