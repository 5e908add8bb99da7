"""The model of films shows what the simulated one does, and looks better."""

from __future__ import annotations

from copy import copy

import mujoco
import numpy as np
import numpy.typing as npt
import pytest

from minidual.config.root import Config
from minidual.config.scene import SceneConfig
from minidual.plant.contact import GROUP_COLLISION
from minidual.plant.model import build_model
from minidual.plant.world import World
from minidual.robot.pair import DUAL_PANDA
from minidual.show.figures.film_camera import FilmCamera
from minidual.show.figures.film_model import CAMERA, film_model, paint_as, painted
from minidual.show.figures.film_objects import LOOKS, PREFIX, look_of
from minidual.show.figures.film_shapes import rounded_box, rounded_cylinder
from minidual.show.figures.film_textures import wood
from minidual.show.view.overlay import Arrow
from minidual.tasks.catalogue import TASKS, make_task

SIZE_PX = (320, 180)


def scene_of(task: str) -> SceneConfig:
    return make_task(Config(task=task)).scene


@pytest.fixture(scope="module")
def world() -> World:
    return World(scene_of("rod_carry"))


def picture(
    model: mujoco.MjModel,
    world: World,
    arrows: tuple[Arrow, ...] = (),
) -> npt.NDArray[np.float64]:
    with FilmCamera(model, SIZE_PX) as camera:
        return camera.picture(world.data.qpos, arrows).astype(float)


@pytest.mark.parametrize("name", TASKS)
def test_its_positions_are_those_of_the_simulated_model(name: str) -> None:
    scene = scene_of(name)
    film = film_model(scene)
    simulated = World(scene).model
    assert film.nq == simulated.nq
    np.testing.assert_array_equal(film.jnt_qposadr, simulated.jnt_qposadr)
    for index in range(simulated.ngeom):
        geom = simulated.geom(index)
        if geom.name:
            same = film.geom(geom.name)
            assert film.body(int(same.bodyid[0])).name == simulated.body(int(geom.bodyid[0])).name


@pytest.mark.parametrize("name", TASKS)
def test_every_object_has_a_look_about_as_large_as_it_is(name: str) -> None:
    """What hands hold is where it seems to be: no look is over 3 mm larger than its object."""
    film = film_model(scene_of(name))
    data = mujoco.MjData(film)
    mujoco.mj_kinematics(film, data)
    for body in scene_of(name).objects:
        geoms = np.flatnonzero(film.geom_bodyid == film.body(body).id)
        hidden = film.geom_group[geoms] == GROUP_COLLISION
        looks = [k for k in geoms if look_of(film.geom(k).name) is not None]
        assert sorted(looks) == sorted(geoms[~hidden].tolist())
        simulated = np.array([extent(film, k) for k in geoms[hidden]])
        shown = np.array([extent(film, k) for k in looks])
        np.testing.assert_allclose(shown[:, 0].min(0), simulated[:, 0].min(0), atol=0.003)
        np.testing.assert_allclose(shown[:, 1].max(0), simulated[:, 1].max(0), atol=0.003)


def extent(model: mujoco.MjModel, geom: int) -> npt.NDArray[np.float64]:
    """Return the lower and upper corner (2, 3) [m] of a geom, in its body's frame."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
    rotation = matrix.reshape(3, 3)
    mesh = int(model.geom_dataid[geom])
    if mesh >= 0:
        first = int(model.mesh_vertadr[mesh])
        points = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])]
    elif model.geom_type[geom] == int(mujoco.mjtGeom.mjGEOM_CYLINDER):
        radius, half, _ = model.geom_size[geom]
        signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        points = signs * (radius, radius, half)
    else:
        signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        points = signs * model.geom_size[geom]
    placed = points @ rotation.T + model.geom_pos[geom]
    return np.array([placed.min(axis=0), placed.max(axis=0)])


def test_named_looks_belong_to_objects_of_tasks() -> None:
    objects = {name for task in TASKS for name in scene_of(task).objects}
    assert LOOKS.keys() <= objects


def test_fine_arms_have_all_triangles_and_others_a_share_without_losing_a_part() -> None:
    scene = scene_of("rod_carry")
    usual = film_model(scene)
    fine = film_model(scene, fine=True)
    assert fine.nmeshface > 1.8 * usual.nmeshface
    assert usual.nmesh == fine.nmesh
    assert usual.vis.quality.offsamples == 4
    assert build_model(scene, visuals=True).vis.quality.offsamples == 0


def test_it_takes_the_colours_sizes_and_light_that_a_condition_gave_the_simulated_one() -> None:
    scene = scene_of("rod_carry")
    film = copy(film_model(scene))
    simulated = copy(World(scene).model)
    rod = simulated.geom("rod").id
    simulated.geom_rgba[rod] = (0.1, 0.2, 0.3, 1.0)
    simulated.geom_size[rod] *= 1.1
    simulated.geom("goal_mark").pos[:2] = (0.4, 0.1)
    simulated.geom("table_top").rgba[:] = (0.0, 0.0, 0.0, 1.0)
    simulated.light("key").diffuse[:] *= 0.5
    before = film_model(scene)
    paint_as(film, simulated)
    look = f"{PREFIX}paint/rod/0"
    np.testing.assert_allclose(film.geom(look).rgba, (0.1, 0.2, 0.3, 1.0), atol=1e-6)
    length_before, length = (
        np.ptp(extent(model, model.geom(look).id), axis=0).max() for model in (before, film)
    )
    assert length == pytest.approx(1.1 * length_before, rel=1e-6)
    np.testing.assert_allclose(film.geom("goal_mark").pos[:2], (0.4, 0.1))
    assert film.geom("table_top").rgba[0] == 0.0
    np.testing.assert_allclose(film.light_diffuse, 0.5 * before.light_diffuse, atol=1e-6)
    collar = film.geom(f"{PREFIX}trim/rod/1")
    np.testing.assert_allclose(collar.rgba, before.geom(f"{PREFIX}trim/rod/1").rgba)


def test_a_hidden_object_is_hidden_and_an_unchanged_room_is_shown_unchanged() -> None:
    scene = scene_of("rod_carry")
    simulated = copy(World(scene).model)
    unchanged = painted(scene, DUAL_PANDA, simulated)
    original = film_model(scene)
    np.testing.assert_allclose(unchanged.geom_rgba, original.geom_rgba, atol=1e-6)
    np.testing.assert_allclose(unchanged.geom_pos, original.geom_pos, atol=1e-6)
    np.testing.assert_allclose(unchanged.light_diffuse, original.light_diffuse, atol=1e-6)
    simulated.geom_rgba[simulated.geom_bodyid == simulated.body("rod").id, 3] = 0.0
    film = painted(scene, DUAL_PANDA, simulated)
    looks = [k for k in range(film.ngeom) if film.geom(k).name.startswith(f"{PREFIX}paint/rod")]
    assert film.geom_rgba[looks, 3].max() == 0.0


def test_the_rod_is_orange_where_it_lies_the_table_of_wood_and_the_arms_white(
    world: World,
) -> None:
    shown = picture(film_model(world.scene), world)
    at = pixel(film_model(world.scene), world, world.data.body("rod").xpos)
    red, green, blue = shown[at[1] - 1 : at[1] + 2, at[0] - 2 : at[0] + 3].reshape(-1, 3).max(0)
    assert red > 1.5 * green > 1.5 * blue
    table = pixel(film_model(world.scene), world, np.array([0.75, 0.0, 0.0]))
    red, _, blue = shown[table[1] - 3 : table[1] + 3, table[0] - 3 : table[0] + 3].mean((0, 1))
    assert red > 1.2 * blue
    hand = pixel(film_model(world.scene), world, world.data.body("left_panda_link4").xpos)
    around = shown[hand[1] - 12 : hand[1] + 12, hand[0] - 12 : hand[0] + 12].reshape(-1, 3)
    assert np.percentile(around.min(axis=1), 90) > 150.0


def test_an_arrow_of_a_force_is_drawn_in_its_colour(world: World) -> None:
    model = film_model(world.scene)
    start = np.array([0.6, 0.1, 0.2])
    arrow = Arrow(start, np.array([0.0, 40.0, 0.0]), (255, 0, 255))
    tiny = Arrow(start, np.array([0.0, 0.5, 0.0]), (255, 0, 255))
    without = picture(model, world)
    shaft = pixel(model, world, start - (0.0, 0.1, 0.0))  # its tip is at the hand
    np.testing.assert_array_equal(picture(model, world, (tiny,)), without)
    red, green, blue = picture(model, world, (arrow,))[shaft[1], shaft[0]]
    assert min(red, blue) > 2.0 * green


def pixel(model: mujoco.MjModel, world: World, at: npt.NDArray[np.float64]) -> tuple[int, int]:
    """Return column and row where the film's camera sees a place (3,) [m]."""
    camera = model.camera(CAMERA)
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, camera.quat)
    x, y, z = matrix.reshape(3, 3).T @ (at - camera.pos)
    width, height = SIZE_PX
    focal_px = height / 2.0 / np.tan(np.radians(float(camera.fovy[0])) / 2.0)
    return round(width / 2.0 - focal_px * x / z), round(height / 2.0 + focal_px * y / z)


def test_a_rounded_box_is_closed_convex_and_of_its_size() -> None:
    trimesh = pytest.importorskip("trimesh")
    shape = rounded_box((0.1, 0.05, 0.02), 0.005)
    mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
    assert mesh.is_watertight
    np.testing.assert_allclose(mesh.extents, (0.2, 0.1, 0.04))
    assert 0.9 * 0.2 * 0.1 * 0.04 < mesh.volume < 0.2 * 0.1 * 0.04
    np.testing.assert_allclose(np.linalg.norm(shape.normals, axis=1), 1.0)


def test_a_rounded_cylinder_is_of_its_size() -> None:
    shape = rounded_cylinder(0.05, 0.1, 0.004)
    np.testing.assert_allclose(np.ptp(shape.vertices, axis=0), (0.1, 0.1, 0.2), atol=1e-3)


def test_wood_is_the_same_each_time_and_has_seams() -> None:
    shown = wood(128)
    np.testing.assert_array_equal(shown, wood(128))
    rows = shown.mean(axis=(1, 2))
    assert rows.min() < 0.85 * rows.max()
