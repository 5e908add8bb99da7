"""env-check passes on the real scene, and each of its checks can say no."""

from __future__ import annotations

import dataclasses
import json

import av
import numpy as np
import pytest

from minidual.config.control import EnvCheckConfig
from minidual.config.root import Config
from minidual.config.scene import PhysicsConfig, SceneConfig
from minidual.control.loop import JointLoop
from minidual.errors import EnvironmentMissingError
from minidual.evaluation import environment as measure
from minidual.evaluation import installation
from minidual.evaluation import joint_tracking as motion
from minidual.evaluation.installation import Library, required_libraries
from minidual.evaluation.step_cost import control_step_cost
from minidual.pipeline.stage import StageContext
from minidual.robot.constants import DOF, HOME
from minidual.robot.kinematics import Kinematics
from minidual.sim.model import build_spec
from minidual.sim.world import World
from minidual.stages.env_check import STAGE

QUICK = EnvCheckConfig(
    sine_duration_s=2.0, cost_steps_n=300, video_width_px=160, video_height_px=120, agreement_states_n=4
)


def run_stage(folder, **changes):
    config = Config(env_check=QUICK.model_copy(update=changes))
    context = StageContext(folder=folder, config=config, seed=config.seed, profile="standard")
    return STAGE.run(context)


def failed(result):
    return {check.name for check in result.checks if check.passed is False}


@pytest.fixture(scope="module")
def passed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("env-check")
    return folder, run_stage(folder)


@pytest.fixture
def loop(world, kinematics):
    return JointLoop(world, kinematics)


class TestStage:
    def test_it_passes_on_the_real_scene(self, passed):
        _, result = passed
        assert failed(result) == set()
        names = {check.name for check in result.checks}
        assert {
            "joints.count", "joints.mapped", "joints.reached", "tracking.step_error_rad", "tracking.sine_rms_rad",
            "contacts.home", "model.agreement_max", "control.step_median_us", "libraries.unfit",
        } <= names  # fmt: skip

    def test_its_limits_are_the_goals_not_the_baselines(self, passed):
        limits = {check.name: check.limit for check in passed[1].checks}
        assert limits["tracking.step_error_rad"] == 0.005
        assert limits["tracking.sine_rms_rad"] == 0.02
        assert limits["control.step_median_us"] == 1000.0

    def test_its_artefacts_are_there_and_whole(self, passed):
        folder, _ = passed
        assert {p.name for p in folder.iterdir()} == {
            "environment.json",
            "sine.mp4",
            "cameras.png",
            "tracking.png",
        }
        with av.open(str(folder / "sine.mp4")) as film:
            frames = [f.to_ndarray(format="rgb24") for f in film.decode(video=0)]
        assert len(frames) == 2 * QUICK.video_fps
        assert (
            np.abs(frames[0].astype(int) - frames[25]).mean() > 2.0
        )  # half a period later the arms are elsewhere
        data = json.loads((folder / "environment.json").read_text())
        assert data["libraries"]["mujoco"]["found"].startswith("4.")
        assert data["machine"]["python"].startswith("3.12")

    def test_its_data_is_json_without_nan(self, passed):
        data = passed[1].data
        assert data
        assert json.loads(json.dumps(data, allow_nan=False)).keys() == data.keys()

    def test_a_lost_motor_fails_the_count_and_stops_there(self, tmp_path, monkeypatch):
        def without_a_motor(scene, *, visuals=True):
            spec = build_spec(scene, visuals=False)
            spec.delete(spec.actuator("left_panda_joint6_motor"))
            return spec.compile()

        monkeypatch.setattr("minidual.sim.model.build_model", without_a_motor)
        result = run_stage(tmp_path)
        assert failed(result) == {"joints.count"}
        assert {c.name: c.observed for c in result.checks}["joints.count"] == 13

    def test_no_gl_ends_it_as_a_missing_environment(self, tmp_path, monkeypatch):
        def broken(*_args):
            raise RuntimeError("no EGL")

        monkeypatch.setattr("minidual.sim.render.mujoco.Renderer", broken)
        with pytest.raises(EnvironmentMissingError, match="no EGL"):
            run_stage(tmp_path)

    def test_limits_that_cannot_be_met_are_not_met(self, tmp_path):
        result = run_stage(tmp_path, sine_rms_max_rad=1e-9, step_error_max_rad=1e-17, agreement_max=1e-18)
        assert failed(result) == {"tracking.sine_rms_rad", "tracking.step_error_rad", "model.agreement_max"}

    def test_limits_weaker_than_the_baseline_are_no_configuration(self):
        for name in ("sine_rms_max_rad", "step_error_max_rad"):
            with pytest.raises(ValueError, match=name):
                EnvCheckConfig(**{name: 0.06})


class TestMapping:
    def test_all_motors_move_their_own_joint(self, world, kinematics):
        mapping = measure.torque_pulse_mapping(world, kinematics)
        assert mapping.mapped == DOF
        assert mapping.error.max() < 1e-3

    @pytest.mark.parametrize(("a", "b"), [(0, 1), (4, 6), (2, 9), (0, 7)])
    def test_two_swapped_commands_are_found(self, world, kinematics, a, b):
        ctrl = world.joints.ctrl.copy()
        ctrl[[a, b]] = ctrl[[b, a]]
        world.joints = dataclasses.replace(world.joints, ctrl=ctrl)
        mapping = measure.torque_pulse_mapping(world, kinematics)
        assert mapping.mapped == DOF - 2
        assert (mapping.moved[a], mapping.moved[b]) == (b, a)

    def test_a_dead_motor_moves_nothing(self, scene, kinematics):
        spec = build_spec(scene, visuals=False)
        spec.actuator("right_panda_joint2_motor").gainprm[0] = 1.0
        model = spec.compile()
        world = World(scene, model=model)
        model.actuator_forcerange[world.joints.ctrl[8]] = 0.0
        mapping = measure.torque_pulse_mapping(world, kinematics)
        assert mapping.moved[8] == -1
        assert mapping.mapped == DOF - 1

    def test_a_reversed_motor_is_found(self, scene, kinematics, compiled_model):
        world = World(scene, model=compiled_model)
        sign = np.ones(DOF)
        sign[3] = -1.0
        command = world.command
        world.command = lambda tau, fingers: command(sign * tau, fingers)
        assert measure.torque_pulse_mapping(world, kinematics).mapped < DOF

    def test_motors_are_counted_through_the_transmission(self, scene, compiled_model):
        assert len(measure.drivable_joints(compiled_model)) == DOF
        spec = build_spec(scene, visuals=False)
        spec.delete(spec.actuator("left_panda_joint1_motor"))
        spec.actuator("left_panda_joint2_motor").set_to_position(kp=10.0)
        found = measure.drivable_joints(spec.compile())
        assert len(found) == DOF - 2
        assert not {"left_panda_joint1", "left_panda_joint2"} & set(found)


class TestTracking:
    def test_the_step_is_reached_to_rounding(self, loop):
        step = motion.step_response(loop, motion.outward_step(0.3), 2.0)
        assert step.settled < 1e-6
        assert step.overshoot < 1e-4
        assert step.error_norm[0] == pytest.approx(0.3 * np.sqrt(2), rel=1e-3)
        assert step.reference[-1][[0, 7]] == pytest.approx(HOME[[0, 7]] + [0.3, -0.3])

    def test_with_the_motors_off_it_is_not(self, loop, monkeypatch):
        monkeypatch.setattr(loop.controller, "torque", lambda *_: np.zeros(DOF))
        assert motion.step_response(loop, motion.outward_step(0.3), 1.0).settled > 0.3

    def test_an_error_that_crosses_zero_is_still_an_error(self):
        t = np.arange(1000) * 1e-3
        swinging = np.zeros((1000, DOF))
        swinging[:, 0] = 0.1 * np.sin(2 * np.pi * 5.0 * (t - t[-1]))  # zero at the last instant
        found = motion.Tracking(t, np.zeros((1000, DOF)), swinging, np.zeros((1000, 1)))
        assert found.error_norm[-1] < 1e-9
        assert found.settled == pytest.approx(0.1, rel=0.01)

    def test_each_joint_alone_arrives(self, loop):
        assert motion.single_joint_errors(loop, 0.1, 0.6).max() < 0.001

    def test_a_blocked_joint_does_not_and_its_neighbours_do(self, scene, kinematics):
        spec = build_spec(scene, visuals=False)
        spec.joint("left_panda_joint5").frictionloss = 50.0  # more than its motor can
        blocked = JointLoop(World(scene, model=spec.compile()), kinematics)
        errors = motion.single_joint_errors(blocked, 0.1, 0.6)
        assert errors[4] > 0.05
        assert np.delete(errors, 4).max() < 0.005

    def test_the_swing_is_followed(self, loop):
        sine = motion.sine_response(loop, 0.3, 0.5, 2.0)
        assert sine.rms < 0.002
        assert sine.contacts == 0
        assert np.ptp(sine.measured, axis=0) == pytest.approx(np.full(DOF, 0.6), abs=0.01)

    def test_a_slack_controller_fails_the_swing(self, world, kinematics):
        slack = JointLoop(world, kinematics, natural_frequency_rad_s=1.0)
        slack.controller._model = kinematics.model.copy()
        slack.controller._model.gravity.linear = np.array([0.0, 0.0, -9.0])
        assert motion.sine_response(slack, 0.3, 0.5, 2.0).rms > 0.02

    def test_the_swings_reference_is_consistent_and_starts_at_rest(self):
        h = 1e-6
        for t in (0.0, 0.3, 1.7):
            _, v, a = motion.sine_reference(0.3, 0.5, t)
            after, before = motion.sine_reference(0.3, 0.5, t + h), motion.sine_reference(0.3, 0.5, t - h)
            assert (after[0] - before[0]) / (2 * h) == pytest.approx(v, abs=1e-8)
            assert (after[1] - before[1]) / (2 * h) == pytest.approx(a, abs=1e-8)
        assert not motion.sine_reference(0.3, 0.5, 0.0)[1].any()
        with pytest.raises(ValueError, match="velocity limits"):
            motion.sine_reference(0.5, 1.0, 0.0)
        with pytest.raises(ValueError, match="joint limits"):
            motion.sine_reference(2.0, 0.1, 0.0)


class TestContacts:
    def test_none_at_home_though_the_rod_touches_the_table(self, world):
        assert world.contact_count > 0
        assert measure.arm_contacts(world) == []

    def test_a_hand_in_the_table_is_counted_and_named(self, world):
        q = HOME.copy()
        q[1], q[3] = 1.0, -1.6
        world.reset(q)
        pairs = measure.arm_contacts(world)
        assert pairs
        assert any("table" in pair[:2] for pair in pairs)

    def test_arms_that_reach_across_collide(self, world):
        q = HOME.copy()
        q[0], q[7] = -0.9, 0.9
        world.reset(q)
        assert any(
            a.startswith("left_") and b.startswith("right_") for a, b, _ in measure.arm_contacts(world)
        )


class TestAgreement:
    def test_the_engines_agree(self, world, kinematics):
        found = measure.model_agreement(world, kinematics, np.random.default_rng(0), 10)
        assert set(found) == {"position_m", "rotation", "inertia_kg_m2", "bias_nm"}
        assert max(found.values()) < 1e-11

    def test_a_changed_rotor_inertia_shows_in_the_inertia_alone(self, scene, kinematics):
        spec = build_spec(scene, visuals=False)
        spec.joint("left_panda_joint1").armature = 0.11
        found = measure.model_agreement(
            World(scene, model=spec.compile()), kinematics, np.random.default_rng(0), 2
        )
        assert found["inertia_kg_m2"] == pytest.approx(0.01)
        assert max(found["position_m"], found["bias_nm"]) < 1e-11

    def test_a_moved_base_shows_in_the_position(self, scene, kinematics):
        spec = build_spec(scene, visuals=False)
        spec.body("right_panda_link0").pos += [0.001, 0.0, 0.0]
        found = measure.model_agreement(
            World(scene, model=spec.compile()), kinematics, np.random.default_rng(0), 2
        )
        assert found["position_m"] == pytest.approx(0.001)

    def test_a_changed_mass_shows_in_gravity(self, world):
        other = Kinematics()
        other.model = other.model.copy()
        other.model.inertias[5].mass += 0.1
        other.data = other.model.createData()
        assert measure.model_agreement(world, other, np.random.default_rng(0), 2)["bias_nm"] > 1e-3


class TestCost:
    def test_a_step_fits_into_a_millisecond_and_costs_more_than_physics(self, loop):
        cost = control_step_cost(loop, 300)
        assert 0.0 < cost.bare_median_us < cost.median_us < 1000.0
        assert cost.ratio == pytest.approx(cost.median_us / cost.bare_median_us)

    def test_a_slow_controller_is_seen(self, loop, monkeypatch):
        import time

        torque = loop.controller.torque

        def slow(*state):
            time.sleep(0.0015)
            return torque(*state)

        monkeypatch.setattr(loop.controller, "torque", slow)
        assert control_step_cost(loop, 100).median_us > 1000.0


class TestLibraries:
    def test_everything_required_is_found(self):
        libraries = {library.name: library for library in required_libraries()}
        assert {"mujoco", "pin", "ompl", "toppra", "torch", "lerobot"} <= set(libraries)
        assert all(library.fits for library in libraries.values())

    def test_missing_and_wrong_versions_do_not_fit(self):
        assert not Library("mujoco", ">=4.0.0,<4.1", None).fits
        assert not Library("mujoco", ">=4.0.0,<4.1", "3.9.0").fits
        assert Library("mujoco", ">=4.0.0,<4.1", "4.0.3").fits
        assert Library("anything", "", "0.1").fits

    def test_requirement_lines_are_read(self, monkeypatch):
        lines = ["a>=1,<2", "b[x]~=3.0", 'c; extra == "dev"', "D"]
        monkeypatch.setattr(installation.importlib.metadata, "requires", lambda _: lines)
        found = {"a": "1.5", "b": "2.0"}

        def version(name):
            if name not in found:
                raise installation.importlib.metadata.PackageNotFoundError(name)
            return found[name]

        monkeypatch.setattr(installation.importlib.metadata, "version", version)
        read = {
            library.name: (library.wanted, library.found, library.fits) for library in required_libraries()
        }
        assert read == {"a": (">=1,<2", "1.5", True), "b": ("~=3.0", "2.0", False), "D": ("", None, False)}


def test_the_scene_is_part_of_what_makes_the_verdict_stale():
    one, other = Config(), Config(scene=SceneConfig(physics=PhysicsConfig(impratio=50.0)))
    assert STAGE.parameters(one) != STAGE.parameters(other)
