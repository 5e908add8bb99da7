"""Shadows of the films: none that nothing casts, and no trace of them in what the policy sees."""

import numpy as np
import numpy.typing as npt
import pytest

from minidual.config.scene import SceneConfig
from minidual.plant import render
from minidual.plant.model import CAMERAS
from minidual.plant.render import Camera
from minidual.plant.world import World
from minidual.show.watch import visual_model


@pytest.fixture(scope="module")
def world() -> World:
    return World(SceneConfig(), model=visual_model(SceneConfig()))


def specks(picture: npt.NDArray[np.uint8]) -> int:
    """Return the dark pixels between two light ones on the floor right of the table, where nothing casts a shadow."""
    brightness = picture[225:480, 540:].astype(int).sum(axis=2)
    lit, dark = brightness > 560, brightness < 450
    between = np.roll(lit, 1, 0) & np.roll(lit, -1, 0) | np.roll(lit, 1, 1) & np.roll(lit, -1, 1)
    return int((dark & between).sum())


def test_the_floor_of_a_film_is_not_speckled(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    with Camera(world.model, 640, 480, shadows=True) as camera:
        picture = camera.picture(world.data, "overview")
    assert specks(picture) == 0
    assert (picture[260:330, 90:200].astype(int).sum(axis=2) < 200).mean() > 0.1  # the arm's shadow is there
    monkeypatch.setattr(render, "_SHADOW_CLIP", 1.0)
    monkeypatch.setattr(render, "_SHADOW_SIZE", 1024)
    with Camera(world.model, 640, 480, shadows=True) as camera:
        assert specks(camera.picture(world.data, "overview")) > 20  # MuJoCo's own reach


def test_the_cameras_that_are_recorded_see_what_they_saw(world: World) -> None:
    settings = SceneConfig().camera
    vis = world.model.vis

    def seen() -> list[npt.NDArray[np.uint8]]:
        with Camera.recorded(world.model, settings) as camera:
            return [camera.picture(world.data, name).copy() for name in CAMERAS]

    kept = float(vis.map.shadowclip), int(vis.quality.shadowsize)
    before = seen()
    with Camera(world.model, 64, 48, shadows=True) as film:
        film.picture(world.data, "overview")
        during = seen()
    assert (float(vis.map.shadowclip), int(vis.quality.shadowsize)) == kept
    assert all(np.array_equal(a, b) for a, b in zip(before, during, strict=True))
    assert len({a.tobytes() for a in before}) == len(CAMERAS)
