"""The condition `randomised`: each part acts in every task, within its range, and is undone."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.config.scene import DISTRACTORS
from minidual.plant.model import build_model
from minidual.plant.sensing import Sensors
from minidual.plant.world import World
from minidual.tasks.catalogue import TASKS, make_task
from minidual.tasks.task import Task, Trial, placement
from minidual.trials.changes import DRY_NM
from minidual.trials.conditions import condition

if TYPE_CHECKING:
    import mujoco

ROW = condition("randomised")
TRIALS_N = 8
EVERY_TASK = pytest.mark.parametrize("name", TASKS)


def seen(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Return copies of what the condition may change."""
    fields = (
        "body_mass",
        "body_inertia",
        "geom_friction",
        "dof_frictionloss",
        "cam_pos",
        "cam_quat",
        "geom_rgba",
    )
    found = {
        field: np.array(getattr(model, field))
        for field in (*fields, "light_diffuse", "geom_pos", "qpos0")
    }
    return found | {"headlight": np.array(model.vis.headlight.diffuse)}


@functools.cache
def drawn(
    name: str,
) -> tuple[Task, mujoco.MjModel, dict[str, np.ndarray], list[tuple[Trial, dict[str, np.ndarray]]]]:
    """Return a task, its model, the model's fields and those of some trials."""
    task = make_task(Config(task=name))
    model = build_model(task.scene, visuals=False)
    plain = seen(model)
    found = []
    for index in range(TRIALS_N):
        trial = task.trial(3, "randomised", index)
        with ROW.applied(model, task, trial, np.random.default_rng(index)):
            found.append((trial, seen(model)))
    return task, model, plain, found


def factors(name: str, field: str) -> np.ndarray:
    """Return a field of every trial over the plain model's; 1 where that is 0 and stays so."""
    _, _, plain, found = drawn(name)
    base = plain[field]
    return np.array(
        [
            np.where(base == 0.0, 1.0 + values[field], values[field] / np.where(base, base, 1.0))
            for _, values in found
        ],
    )


def varies(values: np.ndarray, low: float, high: float) -> None:
    """Assert that values (trials, ...) stay in a range, and that no two trials share one."""
    assert np.all((values >= low) & (values <= high))
    assert all(
        len(np.unique(column)) == len(column) for column in values.reshape(len(values), -1).T
    )


@EVERY_TASK
def test_each_object_has_a_mass_of_its_own(name: str) -> None:
    task, model, _, _ = drawn(name)
    objects = [model.body(item).id for item in task.objects]
    mass = factors(name, "body_mass")
    inertia = factors(name, "body_inertia")
    varies(mass[:, objects], 0.5, 1.5)
    np.testing.assert_allclose(
        inertia[:, objects],
        np.repeat(mass[:, objects, None], 3, axis=2),
        rtol=1e-9,
    )
    assert all(len(np.unique(row)) == len(objects) for row in mass[:, objects])
    np.testing.assert_array_equal(np.delete(mass, objects, axis=1), 1.0)


@EVERY_TASK
def test_all_surfaces_that_meet_slip_alike(name: str) -> None:
    task, model, _, _ = drawn(name)
    bodies = [model.body(item).id for item in task.objects]
    touching = [
        i
        for i in range(model.ngeom)
        if model.geom_bodyid[i] in bodies or model.geom(i).name.endswith("_pad")
    ]
    touching.append(model.geom("table_top").id)
    friction = factors(name, "geom_friction")[:, :, 0]
    varies(friction[:, touching[:1]], 0.4, 1.3)
    assert friction[:, touching[0]].min() < 0.6
    np.testing.assert_allclose(
        friction[:, touching],
        np.repeat(friction[:, touching[:1]], len(touching), axis=1),
    )
    np.testing.assert_array_equal(np.delete(friction, touching, axis=1), 1.0)
    parts = sum(1 + len(item.body.parts) for item in task.objects.values())
    assert len(touching) >= parts + 5, "handles, four pads and the table"


@EVERY_TASK
def test_every_joint_has_dry_friction(name: str) -> None:
    _, model, plain, found = drawn(name)
    hinges = np.flatnonzero(model.jnt_type == 3)
    assert not plain["dof_frictionloss"].any()
    for _, values in found:
        loss = values["dof_frictionloss"]
        assert np.all(
            (loss[model.jnt_dofadr[hinges]] >= 0.5 * DRY_NM)
            & (loss[model.jnt_dofadr[hinges]] <= 1.5 * DRY_NM),
        )
        assert len(np.unique(loss)) == len(hinges) + 1
        assert np.count_nonzero(loss) == len(hinges)


@EVERY_TASK
def test_lights_change_together(name: str) -> None:
    light = factors(name, "light_diffuse").reshape(TRIALS_N, -1)[:, :1]
    varies(light, 0.7, 1.4)
    np.testing.assert_allclose(factors(name, "headlight")[:, :1], light)


@EVERY_TASK
def test_the_camera_moves_by_up_to_two_centimetres_and_three_degrees(name: str) -> None:
    _, model, plain, found = drawn(name)
    high = model.camera("high").id
    shifts = np.array(
        [np.linalg.norm(v["cam_pos"][high] - plain["cam_pos"][high]) for _, v in found],
    )
    cosines = np.array([abs(v["cam_quat"][high] @ plain["cam_quat"][high]) for _, v in found])
    turns = 2.0 * np.arccos(np.clip(cosines, 0.0, 1.0))
    varies(shifts[:, None], 1e-4, 0.02)
    varies(turns[:, None], 1e-4, np.radians(3.0))
    assert shifts.max() > 0.012
    assert turns.max() > np.radians(1.8)


@EVERY_TASK
def test_objects_and_table_change_colour_and_stay_apart(name: str) -> None:
    task, model, plain, found = drawn(name)
    geoms = [model.geom(item).id for item in task.objects]
    table = model.geom("table_top").id
    shifts = np.array(
        [np.abs(v["geom_rgba"] - plain["geom_rgba"])[geoms].max(axis=1) for _, v in found],
    )
    assert np.all(shifts > 0.0)
    assert np.all(shifts.mean(axis=0) > 0.05)
    for _, values in found:
        colours = values["geom_rgba"]
        assert np.abs(colours[table] - plain["geom_rgba"][table]).max() > 0.05
        assert np.all((colours >= 0.0) & (colours <= 1.0))


@EVERY_TASK
def test_distractors_stand_beside_starts_and_goals(name: str) -> None:
    task, model, _, found = drawn(name)
    for trial, values in found:
        for item in DISTRACTORS:
            geom = model.geom(item).id
            place = values["geom_pos"][geom]
            assert values["geom_rgba"][geom, 3] == 1.0
            for poses in (trial.start, trial.goal):
                for body, T in poses.items():
                    (x, y, _) = placement(T)
                    half = min(task.objects[body].body.solids[0].half_m[:2])
                    assert np.hypot(place[0] - x, place[1] - y) > half + 0.03


@EVERY_TASK
def test_the_pose_sensor_is_off_by_a_constant_of_the_trial(name: str) -> None:
    task, model, _, _ = drawn(name)
    sensing = ROW.config_under(task.config).carry.sensing.model_copy(
        update={"pose_noise_m": 0.0, "pose_noise_rad": 0.0, "delay_s": 0.0, "pose_rate_hz": 1000.0},
    )
    world = World(task.scene, model=model)
    world.reset(poses=task.trial(3, "randomised", 0).start)
    offsets = []
    for item in task.objects:
        sensors = Sensors(world, sensing, np.random.default_rng(len(offsets)), item)
        samples = [sensors.sense().pose for _ in range(3)]
        errors = [
            sample.T_world_object[:3, 3] - world.object_pose(item)[:3, 3] for sample in samples
        ]
        np.testing.assert_array_equal(errors[0], errors[2])
        offsets.append(errors[0])
    assert all(1e-4 < np.abs(error).max() < 0.04 for error in offsets)


@EVERY_TASK
def test_nothing_stays_behind(name: str) -> None:
    _, model, plain, _ = drawn(name)
    for field, values in seen(model).items():
        np.testing.assert_array_equal(values, plain[field], err_msg=field)


@EVERY_TASK
def test_no_distractor_hides_an_object(name: str) -> None:
    """In `high`, of objects that stand at the start of their trial."""
    from minidual.plant.render import Camera

    task = make_task(Config(task=name))
    model = build_model(task.scene, visuals=False)
    world = World(task.scene, model=model)
    camera = Camera.recorded(model, task.scene.camera)
    for index in range(4):
        trial = task.trial(3, "hidden", index)
        world.reset(poses=trial.start)
        alone = camera.bodies_seen(world.data, "high")
        with condition("distractors").applied(model, task, trial, np.random.default_rng(index)):
            world.reset(poses=trial.start)
            shown = camera.bodies_seen(world.data, "high")
        for item in task.objects:
            assert shown[item] > 0.5 * alone[item] > 0.0, (index, item)


def test_it_applies_though_the_sensor_has_that_offset_already() -> None:
    config = ROW.config_under(Config())
    assert config.carry.sensing.pose_bias_m == 0.010
    assert config.carry.sensing.pose_bias_rad == 0.03
    assert ROW.why_not("moveit", config) == ""
