"""Small synthetic episodes for the data tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from minidual.demos.schema import EpisodeMeta
from minidual.demos.writer import EpisodeWriter

CAMERAS = ("high", "left", "right")


def arrays(
    ticks: int = 40,
    *,
    seed: int = 0,
    fps: float = 50.0,
    size: tuple[int, int] = (24, 32),
    cameras: Sequence[str] = CAMERAS,
) -> dict[str, Any]:
    """Return a smooth motion with its lagging measurement and drifting gradient pictures."""
    rng = np.random.default_rng(seed)
    t = np.arange(ticks) / fps
    phase = rng.uniform(0, 2 * np.pi, 14)
    action = 0.3 * np.sin(2 * np.pi * 0.5 * (t + 1 / fps)[:, None] + phase)
    qpos = 0.3 * np.sin(2 * np.pi * 0.5 * (t - 0.02)[:, None] + phase)
    height, width = size
    row, column = np.mgrid[0:height, 0:width]
    images = {}
    for index, camera in enumerate(cameras):
        frames = np.empty((ticks, height, width, 3), np.uint8)
        for k in range(ticks):
            frames[k, ..., 0] = 40 + 150 * row / height
            frames[k, ..., 1] = 40 + 60 * index + 80 * ((column + k) % width) / width
            frames[k, ..., 2] = 60 + 120 * (1 + np.sin(2 * np.pi * (k / ticks) + index)) / 2
        images[camera] = frames
    return {
        "qpos": qpos,
        "qvel": np.gradient(qpos, 1 / fps, axis=0),
        "gripper": np.column_stack([0.5 + 0.4 * np.cos(t), 0.5 + 0.4 * np.sin(t)]),
        "action": action,
        "action_gripper": np.column_stack([(t > t[-1] / 2) * 1.0, (t > t[-1] / 3) * 1.0]),
        "timestamps": t + 1.0,
        "images": images,
    }


def write(
    path: Path,
    data: dict[str, Any],
    *,
    success: bool = True,
    fps: float = 50.0,
    **meta: Any,
) -> Path:
    """Write `arrays(...)` as one episode."""
    cameras = tuple(data["images"])
    record = EpisodeMeta(
        fps=fps,
        task="carry the rod",
        seed=meta.pop("seed", 3),
        cameras=cameras,
        **meta,
    )
    with EpisodeWriter(path, record) as writer:
        for k in range(len(data["timestamps"])):
            writer.append(**tick(data, k))
        writer.finish(success=success)
        return writer.publish()


def tick(data: dict[str, Any], k: int) -> dict[str, Any]:
    """Return the arguments of `EpisodeWriter.append` for tick k."""
    values = {key: data[key][k] for key in ("qpos", "action", "gripper", "action_gripper")}
    values["timestamps"] = data["timestamps"][k]
    values["images"] = {camera: frames[k] for camera, frames in data["images"].items()}
    if "qvel" in data:
        values["qvel"] = data["qvel"][k]
    if "image_timestamps" in data:
        values["image_timestamps"] = data["image_timestamps"][k]
    return values
