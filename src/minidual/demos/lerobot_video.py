"""Videos of LeRobot v3 datasets."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from minidual import durable
from minidual.durable import regular_file
from minidual.errors import DataError

Image = NDArray[np.uint8]

VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
BYTES_MAX = 2**36
"""Limit of one file of a dataset."""
REMEDY = (
    "record and convert again, the finished recording is kept beside it: "
    "minidual teleop-record --force"
)
reading = partial(durable.reading, remedy=REMEDY)
"""Context that turns an error of a dataset's damaged content into DataError."""


def decoded(path: Path, expected: int, size: tuple[int, int]) -> Iterator[Image]:
    """Yield a video's pictures (H, W, 3) of `size` (H, W).

    Raises:
        DataError: Corrupt video or another size; at the end, other than `expected` pictures.
    """
    height, width = size
    count = 0
    with reading(path), av.open(str(regular_file(path, BYTES_MAX)), format="mp4") as container:
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
            remedy=REMEDY,
        )
