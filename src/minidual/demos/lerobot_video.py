"""Pictures of LeRobot v3 datasets: in videos, or encoded in the tables."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from minidual.demos.lerobot_features import reading, remedy_of
from minidual.durable import regular_file
from minidual.errors import DataError
from minidual.robot.pair import Array

Image = NDArray[np.uint8]

BYTES_MAX = 2**36
"""Limit of one file of a dataset."""
BRIGHTNESS_MAX = 0.03
"""Limit of a video's difference to the mean that LeRobot recorded, by colour; 1 is full scale."""
_LEROBOT_SAMPLES_N = 100
"""Pictures of an episode from which LeRobot takes the mean."""
_ROWS_AT_ONCE = 32


def decoded(root: Path, name: str, expected: int, size: tuple[int, int]) -> Iterator[Image]:
    """Yield the pictures (H, W, 3) of `size` (H, W) of the video `name` of a dataset.

    Raises:
        DataError: Corrupt video or another size; at the end, other than `expected` pictures.
    """
    height, width = size
    path = root / name
    count = 0
    with (
        reading(path, root),
        av.open(str(regular_file(path, BYTES_MAX)), format="mp4") as container,
    ):
        # The next picture is decoded while one is converted.
        container.streams.video[0].thread_type = "AUTO"
        for count, frame in enumerate(container.decode(video=0), start=1):
            if (frame.height, frame.width) != size:
                raise ValueError(
                    f"its pictures are {frame.height} x {frame.width}, declared {height} x {width}",
                )
            if count > expected:
                break
            picture: Any = frame.to_ndarray(
                format="rgb24",
                width=width,
                height=height,
                interpolation="AREA",
            )
            yield picture
    if count != expected:
        frames = f"more than {expected}" if count > expected else count
        raise DataError(
            f"{path} holds {frames} frames; the table has {expected} rows for it",
            remedy=remedy_of(root),
        )


def stored_in_tables(root: Path, key: str, size: tuple[int, int]) -> Iterator[Image]:
    """Yield the pictures (H, W, 3) that the column `key` of the tables holds as PNG or JPEG.

    Raises:
        DataError: A picture is missing, damaged or of another size.
    """
    for path in data_files(root):
        with reading(path, root), pq.ParquetFile(regular_file(path, BYTES_MAX)) as file:
            for batch in file.iter_batches(_ROWS_AT_ONCE, columns=[key]):
                for cell in batch.column(0).to_pylist():
                    yield _encoded(root, key, cell, size)


def data_files(root: Path) -> list[Path]:
    """Return a dataset's tables of ticks, in order."""
    return sorted((root / "data").glob("chunk-*/file-*.parquet"))


def _encoded(root: Path, key: str, cell: dict[str, Any], size: tuple[int, int]) -> Image:
    """Return the picture of a cell {"bytes", "path"}; ValueError if it is none of `size`."""
    content = cell["bytes"]
    if content is None:
        content = regular_file(root / str(cell["path"]), BYTES_MAX).read_bytes()
    picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        raise ValueError(f"'{key}' holds bytes that are no PNG or JPEG picture")
    if picture.shape[:2] != size:
        height, width = picture.shape[:2]
        raise ValueError(
            f"'{key}' holds a picture of {height} x {width}, declared {size[0]} x {size[1]}",
        )
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def colours(images: Image) -> tuple[Array, Array]:
    """Return mean and std (3,) in [0, 1] of images (N, H, W, 3)."""
    each = np.array([cv2.meanStdDev(image) for image in images])[..., 0] / 255.0
    mean = each[:, 0].mean(axis=0)
    mean_square = (each**2).sum(axis=1).mean(axis=0)
    return mean, np.sqrt(np.maximum(mean_square - mean**2, 0.0))


def colour_difference(images: Image, recorded: Array) -> float:
    """Return how far a recorded mean colour (3,) is from what an episode's pictures can give.

    Both are means over samples. Under light that flickers they depend on which pictures were taken:
    then only a mean outside the range of all pictures counts.
    """
    every = max(1, len(images) // _LEROBOT_SAMPLES_N)
    mean, _ = colours(images[::every])
    difference = float(np.abs(mean - recorded).max())
    if difference <= BRIGHTNESS_MAX:
        return difference
    each = np.array([cv2.mean(image)[:3] for image in images]) / 255.0
    beyond = np.maximum(recorded - each.max(axis=0), each.min(axis=0) - recorded)
    return float(np.maximum(beyond, 0.0).max()) if np.isfinite(recorded).all() else float("nan")
