"""How much a policy's targets depend on each part of a picture."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from minidual.policies.kinds import Image

CELL_PX = 8


def occlusion(predict: Callable[[Image], NDArray[np.float64]], image: Image) -> NDArray[np.float64]:
    """Return the mean change of predicted values when a cell shows the median colour around it, (H, W) in cells."""
    plain, (height, width, _) = predict(image), image.shape
    changes = np.zeros((height // CELL_PX, width // CELL_PX))
    for row, column in np.ndindex(*changes.shape):
        covered, y, x = image.copy(), CELL_PX * row, CELL_PX * column
        around = image[max(0, y - CELL_PX) : y + 2 * CELL_PX, max(0, x - CELL_PX) : x + 2 * CELL_PX]
        covered[y : y + CELL_PX, x : x + CELL_PX] = np.median(around, axis=(0, 1))
        changes[row, column] = np.abs(predict(covered) - plain).mean()
    return changes


def on_object(changes: NDArray[np.float64], image: Image, without: Image) -> float:
    """Return the mean change in cells with the object over the others; `without` lacks it."""
    rows, columns = changes.shape
    differs = (image != without).any(axis=2)[: CELL_PX * rows, : CELL_PX * columns]
    shown = differs.reshape(rows, CELL_PX, columns, CELL_PX).any(axis=(1, 3))
    return float(changes[shown].mean() / changes[~shown].mean())
