"""Conditions change the plant as they say, and leave it as it was."""

from functools import partial

import mujoco
import numpy as np
import pytest

from minidual.config.root import Config
from minidual.errors import UsageError
from minidual.plant.model import build_model
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.tasks.catalogue import TASKS, make_task
from minidual.tasks.insertion import depth_m
from minidual.tasks.judge import begin
from minidual.tasks.task import level_pose
from minidual.trials import changes
from minidual.trials import condition as condition_module
from minidual.trials.changes import DRY_NM
from minidual.trials.condition import Condition
from minidual.trials.conditions import CLEAN, CONDITIONS, condition, parse_conditions
from minidual.trials.disturbances import Push
from minidual.trials.methods import SENSES
from tests.support.placing import put_at

TASK = make_task(Config())
RNG = np.random.default_rng(0)
TRIAL = TASK.trial(0, "conditions", 0)
FIELDS = (
    "body_mass",
    "body_subtreemass",
    "body_inertia",
    "body_invweight0",
    "dof_invweight0",
    "geom_friction",
    "dof_damping",
    "dof_frictionloss",
    "dof_M0",
    "tendon_invweight0",
    "actuator_acc0",
    "light_diffuse",
    "light_specular",
    "cam_pos",
    "cam_quat",
    "geom_rgba",
    "geom_pos",
    "geom_quat",
)
SEEN = {
    "cam_pos",
    "cam_quat",
    "geom_rgba",
    "geom_pos",
    "geom_quat",
    "ambient",
    "diffuse",
    "specular",
}
"""With the lights, what only pictures show."""


def fields(model):
    """Return what conditions may change, and what MuJoCo derives from it."""
    found = {f: np.array(getattr(model, f)) for f in FIELDS}
    return found | {
        f: np.array(getattr(model.vis.headlight, f)) for f in ("ambient", "diffuse", "specular")
    }


@pytest.fixture(scope="module")
def model():
    return build_model(Config().scene, visuals=False)


@pytest.mark.parametrize("name", CONDITIONS)
def test_the_model_is_as_before_afterwards(model, name):
    before = fields(model)
    with condition(name).applied(model, TASK, TRIAL, RNG):
        changed = {f for f, value in fields(model).items() if not np.array_equal(before[f], value)}
        seen = {f for f in changed if "light" in f or f in SEEN}
        assert bool(changed) == (condition(name).change is not None)
        assert bool(changed - seen) == (
            condition(name).change is not None and not condition(name).sense
        )
    for f, value in fields(model).items():
        np.testing.assert_array_equal(before[f], value, err_msg=f)


def test_mass_and_inertia_scale_together(model):
    rod = model.body("rod").id
    mass = model.body_mass[rod]
    inertia = np.array(model.body_inertia[rod])
    with condition("mass +50 %").applied(model, TASK, TRIAL, RNG):
        assert model.body_mass[rod] == pytest.approx(1.5 * mass)
        np.testing.assert_allclose(model.body_inertia[rod], 1.5 * inertia)


def test_friction_holds_for_every_surface_that_the_object_meets(model):
    with condition("friction 0.3").applied(model, TASK, TRIAL, RNG):
        for name in (
            "rod",
            "table_top",
            "left_panda_leftfinger_pad",
            "right_panda_rightfinger_pad",
        ):
            assert model.geom(name).friction[0] == pytest.approx(0.3)


def test_another_joint_each_trial(model):
    for index, joint in (
        (0, "left_panda_joint1"),
        (13, "right_panda_joint7"),
        (14, "left_panda_joint1"),
    ):
        plain = float(model.joint(joint).damping[0])
        before = np.array(model.dof_damping)
        with condition("joint friction x2").applied(
            model,
            TASK,
            TASK.trial(0, "conditions", index),
            RNG,
        ):
            assert model.joint(joint).damping[0] == pytest.approx(2.0 * plain)
            assert model.joint(joint).frictionloss[0] == 2.0 * DRY_NM
            assert (
                np.sum(model.dof_damping != before) == np.count_nonzero(model.dof_frictionloss) == 1
            )


@pytest.mark.parametrize(("torque_nm", "moves"), [(0.6, False), (0.9, True)])
def test_an_arm_feels_the_dry_friction_of_its_joint(model, torque_nm, moves):
    """Under the condition, a torque beside gravity's moves the joint only above 0.72 Nm."""
    world = World(Config().scene, model=model)
    kinematics = Kinematics()
    joint = 6

    def turned() -> float:
        world.reset()
        home = world.q
        extra = np.zeros(14)
        extra[joint] = torque_nm
        for _ in range(100):
            world.command(kinematics.bias(world.q, world.v) + extra, np.full(2, 0.04))
            world.step()
        return float(world.q[joint] - home[joint])

    assert turned() > 0.01
    with condition("joint friction x2").applied(
        model,
        TASK,
        TASK.trial(0, "conditions", joint),
        RNG,
    ):
        assert pytest.approx(0.72) == 2.0 * DRY_NM
        assert (turned() > 1e-3) == moves
    assert turned() > 0.01


@pytest.mark.parametrize("axis", ["+x", "-x", "+y", "-y", "+z", "-z"])
def test_a_push_of_the_table_is_twenty_newton_along_its_axis(axis):
    pusher = condition(f"push {axis}").act(TASK, np.random.default_rng(1))
    force = pusher.at(0.5 * pusher.length_s)
    assert force["xyz".index(axis[1])] == (20.0 if axis[0] == "+" else -20.0)
    assert np.linalg.norm(force) == 20.0
    assert pusher.length_s == pytest.approx(0.24)


class ShortPush(Push):
    duration_s = 0.02
    ramp_s = 0.005
    delays_s = (0.01, 0.01)


class AtOnce(Push):
    delays_s = (0.0, 0.0)


def test_a_push_gives_the_object_its_impulse(model):
    """A free object pushed by F for dt, and by F / 2 during two ramps, gains F (dt + ramp) / m."""
    world = World(Config().scene, model=model)
    world.reset()
    pusher = ShortPush(TASK, np.random.default_rng(0), force_n=(20.0, 0.0, 0.0))
    pusher(world)  # sees it at rest
    world.truth().qpos[2] += 0.3  # somebody lifted it
    gained = []
    for _ in range(60):
        mujoco.mj_step(model, world.data)
        pusher(world)
        gained.append(world.truth().twist()[0])
        assert pusher.took_place == (len(gained) > 40), "it begins after 11 steps and lasts 30"
    assert gained[-1] == pytest.approx(20.0 * 0.025 / 0.2, rel=0.01)
    assert not world.data.xfrc_applied.any()


def test_an_object_on_the_table_is_not_pushed(model):
    world = World(Config().scene, model=model)
    world.reset()
    pusher = AtOnce(TASK, np.random.default_rng(0), force_n=(20.0, 0.0, 0.0))
    for _ in range(20):
        world.step()
        pusher(world)
        assert not world.data.xfrc_applied.any()
    assert not pusher.took_place


def test_a_push_on_an_object_that_was_put_down_again_did_not_take_place(model):
    world = World(Config().scene, model=model)
    world.reset()
    pusher = ShortPush(TASK, np.random.default_rng(0), force_n=(20.0, 0.0, 0.0))
    pusher(world)
    for lifted in (0.3, -0.3):
        world.truth().qpos[2] += lifted
        mujoco.mj_step(model, world.data)
        pusher(world)
    for _ in range(60):
        mujoco.mj_step(model, world.data)
        pusher(world)
    assert not pusher.took_place


def test_a_change_that_breaks_half_way_is_taken_back(model, monkeypatch):
    def broken(model):
        raise ValueError("no constants")

    before = fields(model)
    derive = condition_module._derive
    calls = iter((broken, derive))
    monkeypatch.setattr(condition_module, "_derive", lambda model: next(calls)(model))
    with (
        pytest.raises(ValueError, match="no constants"),
        condition("mass +50 %").applied(model, TASK, TRIAL, RNG),
    ):
        pass
    for f, value in fields(model).items():
        np.testing.assert_array_equal(before[f], value, err_msg=f)


def test_an_object_is_moved_once_and_lies_still_afterwards(model):
    world = World(Config().scene, model=model)
    world.reset()
    before = world.object_pose()
    act = condition("moved 20 mm").act(TASK, np.random.default_rng(1))
    for _ in range(450):
        world.step()
        act(world)
    np.testing.assert_allclose(world.object_pose(), before, atol=1e-4)
    assert not act.took_place
    for _ in range(300):
        world.step()
        act(world)
    assert act.took_place
    moved = world.object_pose()[:3, 3] - before[:3, 3]
    assert np.linalg.norm(moved[:2]) == pytest.approx(0.020, abs=2e-4)
    assert abs(moved[2]) < 1e-4
    np.testing.assert_allclose(world.object_pose()[:3, :3], before[:3, :3], atol=1e-2)


def test_the_first_condition_is_clean_and_names_are_checked():
    assert next(iter(CONDITIONS)) == CLEAN
    assert CONDITIONS[CLEAN].change is None
    assert CONDITIONS[CLEAN].act is None
    for typed in ("mass +50 %", "mass_+50_%", "mass+50%"):
        assert condition(typed) is CONDITIONS["mass +50 %"]
    with pytest.raises(UsageError, match=r"no condition 'fricton 0\.3'") as refused:
        condition("fricton 0.3")
    assert refused.value.remedy == "did you mean 'friction 0.3'?"


def test_a_list_of_conditions_begins_with_the_clean_one():
    assert parse_conditions(["push_+x", "clean", "friction0.3"]) == (
        CLEAN,
        "push +x",
        "friction 0.3",
    )
    assert parse_conditions(["all"]) == tuple(CONDITIONS)
    for typed, says in (
        ("push +x", "lack 'clean'"),
        ("clean,push +x,push_+x", "named twice"),
        ("all,clean", "stands for every condition"),
        ("clean,pusch +x", "no condition"),
    ):
        with pytest.raises(UsageError, match=says):
            parse_conditions(typed.split(","))


def test_what_changes_a_sense_alone_does_not_touch_who_lacks_it():
    noise = CONDITIONS["pose noise x3"]
    assert noise.why_not("act", Config()) == "act reads no sensed pose of the object"
    assert noise.why_not("impedance", Config()) == ""
    late = CONDITIONS["delay 20 ms"]
    assert late.why_not("impedance", Config()) == ""
    assert late.why_not("impedance", Config(task="insertion")).startswith(
        "impedance reads no pose or contact force",
    )
    assert CONDITIONS["mass +50 %"].why_not("act", Config()) == "", "nobody escapes the plant"
    assert {c.sense for c in CONDITIONS.values() if c.sense} == set(SENSES)
    for c in CONDITIONS.values():
        assert not (c.sense and c.act), "what happens in a trial touches every method"


VISUAL = [name for name, row in CONDITIONS.items() if row.sense == "picture"]


@pytest.mark.parametrize("name", VISUAL)
def test_a_changed_room_changes_pictures_and_no_contact(visual_model, name):
    from minidual.plant.render import Camera

    world = World(Config().scene, model=visual_model)
    camera = Camera.recorded(visual_model, Config().scene.camera)

    def look(seed: int) -> tuple[np.ndarray, np.ndarray]:
        with condition(name).applied(visual_model, TASK, TRIAL, np.random.default_rng(seed)):
            world.reset()
            picture = camera.picture(world.data, "high").astype(float)
            for _ in range(50):
                world.step()
            return picture, world.data.qpos.copy()

    world.reset()
    plain = camera.picture(world.data, "high").astype(float)
    for _ in range(50):
        world.step()
    undisturbed = world.data.qpos.copy()
    pictures = [look(seed) for seed in range(4)]
    for picture, qpos in pictures:
        assert np.abs(picture - plain).max() > 30.0
        np.testing.assert_array_equal(qpos, undisturbed)
    differ = any(np.any(picture != pictures[0][0]) for picture, _ in pictures)
    assert differ == (not name.startswith("light") and name != "object hidden"), (
        "every trial draws its own room"
    )


def test_distractors_never_hide_the_object(visual_model):
    from minidual.plant.render import Camera

    world = World(Config().scene, model=visual_model)
    camera = Camera.recorded(visual_model, Config().scene.camera)
    for index in range(20):
        world.reset(poses=TASK.trial(0, "distractors", index).start)
        alone = camera.bodies_seen(world.data, "high")["rod"]
        with condition("distractors").applied(
            visual_model,
            TASK,
            TASK.trial(0, "conditions", index),
            np.random.default_rng(index),
        ):
            mujoco.mj_forward(visual_model, world.data)
            assert camera.bodies_seen(world.data, "high")["rod"] == pytest.approx(alone)


def test_a_wider_start_range_is_drawn_wider():
    wide, narrow = (
        [TASK.trial(0, "range", i, widen=widen).start["rod"][:2] for i in range(200)]
        for widen in (condition("start range x1.5").widen, 1.0)
    )
    assert np.ptp(wide, axis=0) == pytest.approx(1.5 * np.ptp(narrow, axis=0))


def test_a_darker_room_gives_darker_pictures(visual_model):
    from minidual.plant.render import Camera

    world = World(Config().scene, model=visual_model)
    camera = Camera.recorded(visual_model, Config().scene.camera)
    bright = camera.picture(world.data, "high")
    with condition("light -30 %").applied(visual_model, TASK, TRIAL, RNG):
        dark = camera.picture(world.data, "high")
    assert 0.6 < dark.mean() / bright.mean() < 0.9
    np.testing.assert_array_equal(camera.picture(world.data, "high"), bright)


@pytest.mark.parametrize("factor", [0.87, 1.0, 1.13])
@pytest.mark.parametrize("deep_m", [0.02, 0.031])
def test_the_depth_of_a_peg_of_another_size_is_that_of_its_solids(factor, deep_m):
    """Oracle: the places of the geoms in the simulated world."""
    task = make_task(Config(task="insertion"))
    model = build_model(task.scene, visuals=False)
    trial = task.trial(0, "conditions", 0)
    world = World(task.scene, model=model)
    with Condition("size", "", change=partial(changes.size, factor=factor)).applied(
        model,
        task,
        trial,
        RNG,
    ):
        judge = begin(world, task, trial)
        put_at(world, "socket", level_pose(0.5, 0.0, 0.3, 0.0))
        put_at(world, "peg", level_pose(0.5, -0.2, 0.3, 0.0))
        mujoco.mj_forward(model, world.data)
        at = lambda name: world.data.geom(name).xpos  # noqa: E731
        mouth = at("socket_part1")[1] - model.geom("socket_part1").size[1]
        tip = at("peg")[1] + model.geom("peg").size[1]
        x, z = at("socket")[[0, 2]] - at("peg")[[0, 2]]
        put_at(world, "peg", level_pose(0.5 + x, -0.2 + mouth + deep_m - tip, 0.3 + z, 0.0))
        mujoco.mj_forward(model, world.data)
        judge.observe(world)
        assert depth_m(judge.truth) == pytest.approx(deep_m, abs=1e-9)
        put_at(
            world,
            "peg",
            level_pose(0.5 + x, -0.2 + mouth + deep_m - tip, 0.3 + z + 0.002 * factor, 0.0),
        )
        mujoco.mj_forward(model, world.data)
        judge.observe(world)
        assert depth_m(judge.truth) == 0.0, "in a wall"


@pytest.mark.parametrize("name", sorted(TASKS.keys() - {"insertion"}))  # two sizes that fit
@pytest.mark.parametrize("factor", [0.85, 1.15])
def test_an_object_of_another_size_stands_where_it_stood(name, factor):
    task = make_task(Config(task=name))
    model = build_model(task.scene, visuals=False)
    trial = task.trial(0, "conditions", 0)
    body = model.body(task.carried).id
    sizes = model.geom_size[model.geom_bodyid == body].copy()
    world = World(task.scene, model=model)
    with Condition("size", "", change=partial(changes.size, factor=factor)).applied(
        model,
        task,
        trial,
        RNG,
    ):
        assert model.geom_size[model.geom_bodyid == body] == pytest.approx(factor * sizes)
        world.reset(poses=trial.start)
        before = world.data.xpos[body].copy()
        gravity = Kinematics().gravity(world.q)
        for _ in range(200):
            world.command(gravity, np.full(2, world.robot.hand.travel_m))
            world.step()
        assert world.data.xpos[body] == pytest.approx(before, abs=5e-4)
    assert model.geom_size[model.geom_bodyid == body] == pytest.approx(sizes)
