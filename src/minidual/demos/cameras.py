"""Telling cameras apart by what they show: a swap of two cameras is otherwise invisible in a file.

Cameras are fixed in the scene, so the first picture of every episode looks much alike in one camera and
quite unlike another camera's. A thumbnail of it is enough to say which camera it came from.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from minidual.demos import schema
from minidual.demos.checks import Problem
from minidual.demos.episode import read_meta
from minidual.errors import DataError

_ROWS, _COLUMNS = 12, 16


def thumbnail(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the (12, 16, 3) block means of an (H, W, 3) picture, 0 to 255."""
    rows = np.array_split(np.arange(image.shape[0]), min(_ROWS, image.shape[0]))
    columns = np.array_split(np.arange(image.shape[1]), min(_COLUMNS, image.shape[1]))
    blocks = [[image[r[0] : r[-1] + 1, c[0] : c[-1] + 1].mean(axis=(0, 1)) for c in columns] for r in rows]
    return np.asarray(blocks, dtype=np.float32)


def camera_references(paths: Sequence[Path | str]) -> dict[str, NDArray[np.float32]]:
    """Return each camera's median thumbnail over the first pictures of several episodes.

    Raises:
        DataError: a file cannot be read, or two episodes have other cameras.
    """
    views: dict[str, list[NDArray[np.float32]]] = {}
    for path in paths:
        meta, _ = read_meta(path)
        if views and set(meta.cameras) != set(views):
            raise DataError(f"{path} has cameras {', '.join(meta.cameras)}, other episodes {', '.join(views)}")
        try:
            with h5py.File(path, "r") as file:
                for camera in meta.cameras:
                    views.setdefault(camera, []).append(thumbnail(file[schema.image_key(camera)][0]))
        except (OSError, KeyError, RuntimeError) as error:
            raise DataError(f"{path} is truncated or corrupt: {error}") from error
    return {camera: np.median(np.stack(seen), axis=0) for camera, seen in views.items()}


def check_swapped(
    images: Mapping[str, NDArray[np.uint8]], references: Mapping[str, NDArray[np.float32]]
) -> list[Problem]:
    """Report each camera whose first picture is nearer to another camera's reference than to its own.

    Args:
        images: (T, H, W, 3) by camera.
        references: The result of `camera_references` over the other episodes.
    """
    problems: list[Problem] = []
    for camera, frames in images.items():
        if camera not in references:
            continue
        view = thumbnail(frames[0])
        distances = {
            name: float(np.mean(np.abs(view - reference)))
            for name, reference in references.items()
            if reference.shape == view.shape
        }
        nearest = min(distances, key=distances.__getitem__, default=camera)
        if nearest != camera:
            problems.append(
                Problem(
                    "cameras_swapped",
                    f"camera '{camera}' shows what '{nearest}' shows in the other episodes (mean difference "
                    f"{distances[nearest]:.1f} of 255 against {distances.get(camera, float('nan')):.1f})",
                    "check the order in which cameras are rendered and named; on hardware, the cables",
                )
            )
    return problems
