"""Where a predictor looks, by covering parts of a picture."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from minidual.policies.chunk_policy import Image

CELL_PX = 8


def occlusion(predict: Callable[[Image], NDArray[np.float64]], image: Image) -> NDArray[np.float64]:
    """Return the mean change of predicted values for each covered cell, (H, W) in cells.

    A covered cell shows the median colour around it.
    """
    plain = predict(image)
    height, width, _ = image.shape
    changes = np.zeros((height // CELL_PX, width // CELL_PX))
    for row, column in np.ndindex(*changes.shape):
        covered = _covered(image, CELL_PX * row, CELL_PX * column)
        changes[row, column] = np.abs(predict(covered) - plain).mean()
    return changes


def _covered(image: Image, y: int, x: int) -> Image:
    """Return the picture with the cell at (y, x) [px] covered."""
    top = max(0, y - CELL_PX)
    left = max(0, x - CELL_PX)
    around = image[top : y + 2 * CELL_PX, left : x + 2 * CELL_PX]
    covered = image.copy()
    covered[y : y + CELL_PX, x : x + CELL_PX] = np.median(around, axis=(0, 1))
    return covered


def on_object(changes: NDArray[np.float64], image: Image, without: Image) -> float:
    """Return the mean change in cells with the object over that in the others.

    `without` is the picture without the object; 0 where the object is not seen.
    """
    rows, columns = changes.shape
    differs = (image != without).any(axis=2)[: CELL_PX * rows, : CELL_PX * columns]
    cells = differs.reshape(rows, CELL_PX, columns, CELL_PX)
    visible = cells.any(axis=(1, 3))
    if not visible.any():
        return 0.0
    return float(changes[visible].mean() / max(changes[~visible].mean(), 1e-12))
