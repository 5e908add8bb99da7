"""Conditions change the plant as they say, and leave it as it was."""

import mujoco
import numpy as np
import pytest

from minidual.config.root import Config
from minidual.errors import UsageError
from minidual.evaluation.conditions import CLEAN, CONDITIONS, Push, _Pusher, condition
from minidual.sim.model import build_model
from minidual.sim.world import World

FIELDS = ("body_mass", "body_subtreemass", "body_inertia", "body_invweight0", "dof_invweight0", "geom_friction",
          "dof_damping", "dof_frictionloss", "dof_M0", "tendon_invweight0", "actuator_acc0")  # fmt: skip


@pytest.fixture(scope="module")
def model():
    return build_model(Config().scene, visuals=False)


@pytest.mark.parametrize("name", CONDITIONS)
def test_the_model_is_as_before_afterwards(model, name):
    before = {f: np.array(getattr(model, f)) for f in FIELDS}
    with condition(name).applied(model, 3):
        changed = any(not np.array_equal(before[f], getattr(model, f)) for f in FIELDS)
        assert changed == condition(name).changes_the_plant
    for f in FIELDS:
        np.testing.assert_array_equal(before[f], getattr(model, f), err_msg=f)


def test_mass_and_inertia_scale_together(model):
    rod = model.body("rod").id
    mass, inertia = model.body_mass[rod], np.array(model.body_inertia[rod])
    with condition("mass +50 %").applied(model, 0):
        assert model.body_mass[rod] == pytest.approx(1.5 * mass)
        np.testing.assert_allclose(model.body_inertia[rod], 1.5 * inertia)


def test_friction_holds_for_every_surface_that_the_object_meets(model):
    with condition("friction 0.3").applied(model, 0):
        for name in ("rod", "table_top", "left_panda_leftfinger_pad", "right_panda_rightfinger_pad"):
            assert model.geom(name).friction[0] == pytest.approx(0.3)


def test_another_joint_each_trial(model):
    for index, joint in ((0, "left_panda_joint1"), (13, "right_panda_joint7"), (14, "left_panda_joint1")):
        plain, before = float(model.joint(joint).damping[0]), np.array(model.dof_damping)
        with condition("joint friction x2").applied(model, index):
            assert model.joint(joint).damping[0] == pytest.approx(2.0 * plain)
            assert np.sum(model.dof_damping != before) == 1


def test_a_push_gives_the_object_its_impulse(model):
    """A free object pushed by F for dt, and by half of it during two ramps, gains F (dt + ramp) / m."""
    world = World(Config().scene, model=model)
    world.reset()
    address = int(model.joint("rod_free").qposadr[0])
    pusher = _Pusher(Push((20.0, 0.0, 0.0), 0.02, ramp_s=0.005), delay_s=0.01)
    pusher(world)  # sees it at rest
    world.data.qpos[address + 2] += 0.3  # somebody lifted it
    gained = []
    for _ in range(60):
        mujoco.mj_step(model, world.data)
        pusher(world)
        gained.append(world.rod_twist[0])
    assert gained[-1] == pytest.approx(20.0 * 0.025 / 0.2, rel=0.01)
    assert not world.data.xfrc_applied.any()


def test_an_object_on_the_table_is_not_pushed(model):
    world = World(Config().scene, model=model)
    world.reset()
    pusher = _Pusher(Push((20.0, 0.0, 0.0)), delay_s=0.0)
    for _ in range(20):
        world.step()
        pusher(world)
        assert not world.data.xfrc_applied.any()


def test_the_first_condition_is_clean_and_names_are_checked():
    assert next(iter(CONDITIONS)) == CLEAN
    assert not CONDITIONS[CLEAN].changes_the_plant
    assert CONDITIONS[CLEAN].disturbance(np.random.default_rng(0)) is None
    with pytest.raises(UsageError, match="mass"):
        condition("mass +50%")
