"""The model of films shows what the simulated one does, and looks better."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from minidual.config.root import Config
from minidual.plant.model import build_model
from minidual.plant.render import Camera
from minidual.show.figures.film_model import CAMERA, film_model, paint_as, wood
from minidual.tasks.catalogue import TASKS, make_task


@pytest.mark.parametrize("name", TASKS)
def test_its_positions_and_geoms_are_those_of_the_simulated_model(name: str) -> None:
    scene = make_task(Config(task=name)).scene
    film = film_model(scene)
    plain = build_model(scene, visuals=True)
    assert film.nq == plain.nq
    assert film.ngeom == plain.ngeom
    names = [[model.geom(k).name for k in range(model.ngeom)] for model in (film, plain)]
    assert names[0] == names[1]
    np.testing.assert_array_equal(film.jnt_qposadr, plain.jnt_qposadr)
    np.testing.assert_array_equal(film.geom_bodyid, plain.geom_bodyid)


def test_it_has_more_triangles_and_the_plain_one_has_as_many_as_ever() -> None:
    scene = make_task(Config(task="rod_carry")).scene
    film = film_model(scene)
    plain = build_model(scene, visuals=True)
    assert film.nmeshface > 1.5 * plain.nmeshface
    assert plain.vis.quality.offsamples == 0
    assert film.vis.quality.offsamples == 4


def test_it_takes_the_colours_that_a_condition_gave_the_simulated_one() -> None:
    scene = make_task(Config(task="rod_carry")).scene
    film = film_model(scene)
    plain = build_model(scene, visuals=True)
    rod = plain.geom("rod").id
    table = plain.geom("table_top").id
    plain.geom_rgba[rod] = (0.1, 0.2, 0.3, 1.0)
    plain.geom_rgba[table] = (0.0, 0.0, 0.0, 1.0)
    plain.geom_size[rod] *= 1.1
    paint_as(film, plain)
    np.testing.assert_allclose(film.geom_rgba[rod], (0.1, 0.2, 0.3, 1.0), atol=1e-6)
    np.testing.assert_allclose(film.geom_size[rod], plain.geom_size[rod])
    np.testing.assert_allclose(film.geom_rgba[table], 1.0)
    film_model.cache_clear()


def test_the_table_is_of_wood_and_lit_from_one_side() -> None:
    scene = make_task(Config(task="rod_carry")).scene
    model = film_model(scene)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with Camera(model, 320, 240, shadows=True) as camera:
        picture = camera.picture(data, CAMERA).astype(float)
    red, _, blue = picture[150:230, 100:220].reshape(-1, 3).mean(axis=0)
    assert red > 1.2 * blue
    assert picture.std() > 20.0


def test_wood_is_the_same_each_time_and_has_seams() -> None:
    picture = wood(128)
    np.testing.assert_array_equal(picture, wood(128))
    rows = picture.mean(axis=(1, 2))
    assert rows.min() < 0.85 * rows.max()
