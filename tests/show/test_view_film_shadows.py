"""Shadows of the films: none that nothing casts, and no trace of them in what the policy sees."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pytest

from minidual.config.scene import SceneConfig
from minidual.plant.cameras import CAMERAS
from minidual.plant.render import Camera
from minidual.plant.world import World
from minidual.show.watch import visual_model


@pytest.fixture(scope="module")
def world() -> World:
    return World(SceneConfig(), model=visual_model(SceneConfig()))


def specks(picture: npt.NDArray[np.uint8]) -> int:
    """Return the dark pixels between two light ones on the floor right of the table, where nothing casts a shadow."""
    brightness = picture[225:480, 540:].astype(int).sum(axis=2)
    lit = brightness > 560
    dark = brightness < 450
    between = np.roll(lit, 1, 0) & np.roll(lit, -1, 0) | np.roll(lit, 1, 1) & np.roll(lit, -1, 1)
    return int((dark & between).sum())


@pytest.fixture
def short_reach(world: World) -> Iterator[None]:
    """MuJoCo's own reach of shadows and a smaller map."""
    vis = world.model.vis
    kept = float(vis.map.shadowclip), int(vis.quality.shadowsize)
    vis.map.shadowclip = 1.0
    vis.quality.shadowsize = 1024
    yield
    vis.map.shadowclip, vis.quality.shadowsize = kept


def film(world: World) -> npt.NDArray[np.uint8]:
    with Camera(world.model, 640, 480, shadows=True) as camera:
        return camera.picture(world.data, "overview").copy()


def recorded(world: World) -> list[bytes]:
    with Camera.recorded(world.model, SceneConfig().camera) as camera:
        return [camera.picture(world.data, name).tobytes() for name in CAMERAS]


def test_the_floor_of_a_film_is_not_speckled(world: World) -> None:
    picture = film(world)
    assert specks(picture) == 0
    assert (
        picture[260:330, 90:200].astype(int).sum(axis=2) < 200
    ).mean() > 0.1  # the arm's shadow is there


def test_the_floor_is_speckled_without_the_longer_reach(world: World, short_reach: None) -> None:
    assert specks(film(world)) > 20


def test_the_cameras_that_are_recorded_see_no_shadows(
    world: World,
    request: pytest.FixtureRequest,
) -> None:
    before = recorded(world)
    assert len(set(before)) == len(CAMERAS)
    request.getfixturevalue("short_reach")
    assert recorded(world) == before
