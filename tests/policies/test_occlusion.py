"""The occlusion map shows where a predictor looks, and nothing where it does not."""

from pathlib import Path

import numpy as np
import pytest

from minidual.policies.occlusion import CELL_PX, occlusion, on_object
from minidual.show.figures.canvas import draw_occlusion


def picture() -> np.ndarray:
    """Return a grey picture (40, 56, 3) with a thin red thing in rows 18 to 20, columns 10 to 30."""
    image = np.full((40, 56, 3), 90, dtype=np.uint8)
    image[18:20, 10:30] = (220, 40, 30)
    return image


def redness(image: np.ndarray) -> np.ndarray:
    """Return how much is red."""
    return np.atleast_1d(np.sum(image[..., 0].astype(float) - image[..., 1]) / 180.0)


def test_a_predictor_that_reads_the_object_changes_there_alone() -> None:
    image = picture()
    changes = occlusion(redness, image)
    assert changes.shape == (40 // CELL_PX, 56 // CELL_PX)
    shown = np.zeros_like(changes, dtype=bool)
    shown[2, 1:4] = True
    assert (changes[shown] > 0.5).all()
    assert changes[~shown].max() < 1e-9
    without = np.full_like(image, 90)
    assert on_object(changes + 1e-6, image, without) > 1e3


def test_a_predictor_that_reads_the_background_has_a_small_ratio() -> None:
    image = picture()
    image[:8] = np.random.default_rng(0).integers(0, 255, (8, 56, 3))
    without = image.copy()
    without[18:20] = 90
    changes = occlusion(lambda seen: seen[:8].mean(axis=(0, 2)), image)
    assert on_object(changes, image, without) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.filterwarnings("error")
def test_a_camera_that_does_not_see_the_object_has_no_share_in_looking() -> None:
    image = picture()
    assert on_object(occlusion(redness, image), image, image) == 0.0


def test_a_covered_cell_shows_its_surroundings() -> None:
    seen: list[np.ndarray] = []

    def keep(image: np.ndarray) -> np.ndarray:
        seen.append(image)
        return np.zeros(1)

    occlusion(keep, picture())
    middle = seen[1 + 2 * (56 // CELL_PX) + 2]  # the first is the plain picture
    assert (middle[2 * CELL_PX : 3 * CELL_PX, 2 * CELL_PX : 3 * CELL_PX] == 90).all()
    assert (middle != picture()).any(axis=2).sum() == 2 * CELL_PX


def test_the_figure_is_written(tmp_path: Path) -> None:
    image = picture()
    draw_occlusion({"high": (image, occlusion(redness, image))}, tmp_path / "occlusion.png")
    assert (tmp_path / "occlusion.png").stat().st_size > 5000
