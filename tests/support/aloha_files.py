"""Episodes in ALOHA's own layout."""

from __future__ import annotations

from pathlib import Path

import cv2
import h5py
import numpy as np

TICKS = 30
SIZE = (24, 32)


def write(path: Path, *, seed: int = 0, jpeg: bool = False, cameras: int = 2) -> Path:
    """Write one episode of 14 joints, with efforts, as ALOHA's recorder does."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0, TICKS)[:, None]
    action = np.sin(2.0 * np.pi * (t + rng.uniform(0.0, 1.0, 14)))
    with h5py.File(path, "w") as file:
        file.attrs["sim"] = False
        file["action"] = action
        file["observations/qpos"] = np.vstack([action[:1], action[:-1]])
        file["observations/qvel"] = np.gradient(action, axis=0)
        file["observations/effort"] = 10.0 * action
        for index, camera in enumerate(("cam_high", "cam_left_wrist")[:cameras]):
            pictures = np.stack([picture(k, index) for k in range(TICKS)])
            key = f"observations/images/{camera}"
            if not jpeg:
                file[key] = pictures
                continue
            encoded = [cv2.imencode(".jpg", image[..., ::-1])[1].ravel() for image in pictures]
            longest = max(map(len, encoded))
            file[key] = np.stack([np.pad(each, (0, longest - len(each))) for each in encoded])
    return path


def picture(tick: int, camera: int) -> np.ndarray:
    """Return a gradient (H, W, 3) that drifts; the two cameras differ in colour."""
    row, column = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    image = np.zeros((*SIZE, 3), np.uint8)
    image[..., camera] = 200
    image[..., 2] = 40 + 4 * ((column + tick) % SIZE[1])
    image[..., 1 - camera] = 20 + 3 * row
    return image
