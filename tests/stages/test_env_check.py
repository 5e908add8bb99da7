"""env-check passes on the real scene, and each of its checks can say no."""

from __future__ import annotations

import csv
import json
import platform
from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
import pytest

import minidual
from minidual.cli.app import run_command_line
from minidual.config.control import EnvCheckConfig, SupervisorConfig
from minidual.config.root import Config
from minidual.config.scene import PhysicsConfig, SceneConfig
from minidual.control.arbiter import CommandArbiter
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import EnvironmentMissingError
from minidual.gate.stage import StageContext
from minidual.plant.model import build_spec
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.show.figures.film import FILM_FPS
from minidual.stages.env_check import installation, tracking
from minidual.stages.env_check import model as measure
from minidual.stages.env_check import stage as judge
from minidual.stages.env_check.installation import Library, required_libraries
from minidual.stages.env_check.pictures import CameraCheck
from minidual.stages.env_check.stage import measured_checks, run
from minidual.stages.env_check.tracking import (
    CommandLatency,
    StopResponse,
    arm_contacts,
    command_latency,
    emergency_stop,
    joint_responses,
)
from minidual.stages.registry import STAGES

DOF = DUAL_PANDA.dof
HOME = DUAL_PANDA.home
JOINT_NAMES = DUAL_PANDA.joint_names

QUICK = EnvCheckConfig(sine_duration_s=2.0, agreement_states_n=4)


def run_stage(folder, **changes):
    config = Config(env_check=QUICK.model_copy(update=changes))
    context = StageContext(folder=folder, config=config, seed=config.seed, profile="standard")
    return run(context)


def failed(result):
    return {check.name for check in result.checks if check.passed is False}


@pytest.fixture(scope="module")
def passed(tmp_path_factory):
    """Return the stage's folder, its result and what measured_checks was given."""
    folder = tmp_path_factory.mktemp("env-check")
    given = []

    def judged(*arguments):
        given.extend(arguments)
        return measured_checks(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("minidual.stages.env_check.stage.measured_checks", judged)
        return folder, run_stage(folder), given


def rig_of(world, kinematics, **supervisor):
    return tracking.TrackingRig(
        world,
        kinematics,
        Config(supervisor=SupervisorConfig(**supervisor)),
    )


@pytest.fixture
def rig(world, kinematics):
    return rig_of(world, kinematics)


class TestStage:
    def test_it_passes_on_the_real_scene(self, passed):
        result = passed[1]
        assert failed(result) == set()
        names = {check.name for check in result.checks}
        assert {
            "joints.count",
            "joints.mapped",
            "joints.reached",
            "tracking.step_error_rad",
            "tracking.sine_rms_rad",
            "contacts.home",
            "model.agreement_max",
            "control.step_median_us",
            "libraries.unfit",
            "joints.rise_max_s",
            "joints.overshoot_max_rad",
            "latency.late_steps",
            "latency.wall_median_us",
            "stop.ticks",
            "stop.rest_s",
            "control.stopped",
        } <= names

    def test_its_limits_are_the_goals_not_the_baselines(self, passed):
        limits = {check.name: check.limit for check in passed[1].checks}
        assert limits["tracking.step_error_rad"] == 0.005
        assert limits["tracking.sine_rms_rad"] == 0.02
        assert limits["control.step_median_us"] == 1000.0

    def test_its_artefacts_are_there_and_whole(self, passed):
        folder, result, _ = passed
        assert {p.name for p in folder.iterdir()} == {
            "sine.mp4",
            "cameras.png",
            "tracking.png",
            "joints.csv",
        }
        with av.open(str(folder / "sine.mp4")) as film:
            frames = [f.to_ndarray(format="rgb24") for f in film.decode(video=0)]
        assert len(frames) == 2 * FILM_FPS
        assert (
            np.abs(frames[0].astype(int) - frames[25]).mean() > 2.0
        )  # half a period later the arms are elsewhere
        assert result.data["libraries"]["mujoco"]["found"].startswith("4.")
        with (folder / "joints.csv").open(newline="") as stream:
            rows = list(csv.DictReader(stream))
        assert [row["joint"] for row in rows] == list(JOINT_NAMES)
        assert all(0.0 < float(row["rise_s"]) < 0.25 for row in rows)
        assert max(float(row["sine_peak_rad"]) for row in rows) < 0.005

    def test_every_check_with_a_limit_says_why_and_what_to_do(self, passed):
        for check in passed[1].checks:
            assert check.why or not check.op, check.name
        checks = all_failing_checks()
        assert {check.name for check in checks} == {c.name for c in passed[1].checks if c.op}
        for check in checks:
            assert check.passed is False, check.name
            assert check.remedy, check.name

    def test_its_data_is_json_without_nan(self, passed):
        data = passed[1].data
        assert data
        assert json.loads(json.dumps(data, allow_nan=False)).keys() == data.keys()

    def test_a_lost_motor_fails_the_count_and_stops_there(self, tmp_path, monkeypatch):
        def without_a_motor(scene, robot, *, visuals=True):
            spec = build_spec(scene, robot, visuals=False)
            spec.delete(spec.actuator("left_panda_joint6_motor"))
            return spec.compile()

        monkeypatch.setattr("minidual.stages.env_check.stage.build_model", without_a_motor)
        result = run_stage(tmp_path)
        assert failed(result) == {"joints.count"}
        assert {c.name: c.observed for c in result.checks}["joints.count"] == 13

    def test_no_gl_ends_it_as_a_missing_environment(self, tmp_path, monkeypatch):
        def broken(*_args):
            raise RuntimeError("no EGL")

        monkeypatch.setattr("minidual.plant.render.mujoco.Renderer", broken)
        with pytest.raises(EnvironmentMissingError, match="no EGL"):
            run_stage(tmp_path)

    def test_limits_that_cannot_be_met_are_not_met(self, passed):
        tight = {
            "sine_rms_max_rad": 1e-9,
            "step_error_max_rad": 1e-17,
            "agreement_max": 1e-18,
            "rise_max_s": 0.01,
            "stop_rest_max_s": 0.01,
        }
        found, _, *others = passed[2]
        checks = judge.measured_checks(found, QUICK.model_copy(update=tight), *others)
        assert {check.name for check in checks if check.passed is False} == {
            "tracking.sine_rms_rad",
            "tracking.step_error_rad",
            "model.agreement_max",
            "joints.rise_max_s",
            "stop.rest_s",
        }

    def test_limits_weaker_than_the_baseline_are_no_configuration(self):
        for name in ("sine_rms_max_rad", "step_error_max_rad"):
            with pytest.raises(ValueError, match=name):
                EnvCheckConfig(**{name: 0.06})


def response(joint, rise_s, overshoot_rad, settled_rad):
    return {
        "joint": joint,
        "rise_s": rise_s,
        "overshoot_rad": overshoot_rad,
        "settled_rad": settled_rad,
    }


def measured(**changes):
    """Return measurements in which all is well, or with some fields changed."""
    still = np.zeros((300, DOF))
    rest = tracking.Tracking(np.arange(300) * 1e-3, still, still, HOME)
    fields = {
        "moved": tuple(range(DOF)),
        "steps": [rest] * DOF,
        "contacts": [],
        "responses": [response(name, 0.1, 0.0, 0.0) for name in JOINT_NAMES],
        "step": rest,
        "sine": rest,
        "agreement": {"position_m": 0.0},
        "latency": CommandLatency((1, *range(20, 1, -1)), 100.0),
        "stop": StopResponse(1, 0.3, 1.0),
        "cameras": CameraCheck(30.0, 0.1, 0.1, "none"),
        "frames": round(QUICK.sine_duration_s * FILM_FPS),
    }
    return judge.Measured(**(fields | changes))


def judged(**changes):
    return {
        check.name: check for check in judge.measured_checks(measured(**changes), QUICK, DUAL_PANDA)
    }


def all_failing_checks():
    """Return every check with a limit, made from measurements in which everything is broken."""
    nan = float("nan")
    wide = np.full((300, DOF), nan)
    lost = tracking.Tracking(
        np.arange(300) * 1e-3,
        wide,
        np.zeros((300, DOF)),
        HOME,
        3,
        nan,
        "joint_speed: too fast",
    )
    checks = judged(
        moved=(-1,) * DOF,
        contacts=[("left_panda_hand", "table", -0.01)],
        responses=[response(name, nan, nan, nan) for name in JOINT_NAMES],
        step=lost,
        sine=lost,
        agreement={"position_m": nan},
        latency=CommandLatency((60,) * 20, nan),
        stop=StopResponse(0, nan, nan),
        cameras=CameraCheck(0.0, 0.0, 0.0, "none"),
        frames=0,
    )
    installed = judge.installation_checks([Library("mujoco", ">=4", None)], DOF - 1, DUAL_PANDA)
    return [check for check in (*installed, *checks.values()) if check.op]


def test_measurements_in_which_all_is_well_pass():
    checks = judged()
    reported = {name for name, check in checks.items() if check.op is None}
    assert reported == {"latency.wall_median_us"}
    assert all(check.passed for name, check in checks.items() if name not in reported)


class TestMapping:
    def test_all_motors_move_their_own_joint(self, world, kinematics):
        assert measure.torque_pulse_mapping(
            world,
            Supervisor(),
            kinematics,
            tolerance=1e-3,
        ) == tuple(range(DOF))

    def test_every_pulse_passes_the_supervisor(self, world, kinematics, monkeypatch):
        applied = []
        command = world.command
        monkeypatch.setattr(
            world,
            "command",
            lambda tau, fingers: (applied.append(tau), command(tau, fingers)),
        )
        supervisor = Supervisor()
        measure.torque_pulse_mapping(world, supervisor, kinematics)
        pulses = np.array(applied) - kinematics.gravity(HOME)
        assert len(pulses) == DOF + 1
        assert np.abs(pulses).max() == pytest.approx(supervisor.bounds.tau_step, abs=1e-9)

        # A supervisor that stops the arms leaves no joint mapped, instead of being passed by.
        supervisor = Supervisor(SupervisorConfig(torque_scale=0.01))
        assert -1 in measure.torque_pulse_mapping(world, supervisor, kinematics)

    @pytest.mark.parametrize(("a", "b"), [(0, 1), (4, 6), (2, 9), (0, 7)])
    def test_two_swapped_commands_are_found(self, world, kinematics, a, b):
        ctrl = world.joints.ctrl.copy()
        ctrl[[a, b]] = ctrl[[b, a]]
        world.joints = world.joints._replace(ctrl=ctrl)
        expected = list(range(DOF))
        expected[a], expected[b] = b, a
        assert measure.torque_pulse_mapping(world, Supervisor(), kinematics) == tuple(expected)

    def test_a_dead_motor_moves_nothing(self, scene, kinematics):
        spec = build_spec(scene, visuals=False)
        spec.actuator("right_panda_joint2_motor").gainprm[0] = 1.0
        model = spec.compile()
        world = World(scene, model=model)
        model.actuator_forcerange[world.joints.ctrl[8]] = 0.0
        moved = measure.torque_pulse_mapping(world, Supervisor(), kinematics)
        assert moved == (*range(8), -1, *range(9, DOF))

    def test_a_reversed_motor_is_found(self, scene, kinematics, compiled_model):
        world = World(scene, model=compiled_model)
        sign = np.ones(DOF)
        sign[3] = -1.0
        command = world.command
        world.command = lambda tau, fingers: command(sign * tau, fingers)
        assert measure.torque_pulse_mapping(world, Supervisor(), kinematics)[3] == -1

    def test_motors_are_counted_through_the_transmission(self, scene, compiled_model):
        assert len(measure.drivable_joints(compiled_model, DUAL_PANDA)) == DOF
        spec = build_spec(scene, visuals=False)
        spec.delete(spec.actuator("left_panda_joint1_motor"))
        spec.actuator("left_panda_joint2_motor").set_to_position(kp=10.0)
        found = measure.drivable_joints(spec.compile(), DUAL_PANDA)
        assert len(found) == DOF - 2
        assert not {"left_panda_joint1", "left_panda_joint2"} & set(found)


class TestTracking:
    def test_the_step_is_reached_to_rounding(self, rig):
        step = tracking.step_response(rig, tracking.outward_step(DUAL_PANDA, 0.3), 2.0)
        assert step.settled < 1e-6
        assert step.stopped == ""
        assert step.error_norm[0] == pytest.approx(0.3 * np.sqrt(2), rel=1e-3)
        assert step.reference[-1][[0, 7]] == pytest.approx(HOME[[0, 7]] + [0.3, -0.3])

    def test_with_the_motors_off_it_is_not_and_the_supervisor_says_so(self, rig, monkeypatch):
        command = rig.world.command
        monkeypatch.setattr(rig.world, "command", lambda tau, fingers: command(0.0 * tau, fingers))
        step = tracking.step_response(rig, tracking.outward_step(DUAL_PANDA, 0.3), 1.0)
        assert step.settled > 0.3
        assert step.stopped
        assert judged(step=step)["control.stopped"].passed is False

    def test_an_error_that_crosses_zero_is_still_an_error(self):
        t = np.arange(1000) * 1e-3
        swinging = np.zeros((1000, DOF))
        swinging[:, 0] = 0.1 * np.sin(2 * np.pi * 5.0 * (t - t[-1]))  # zero at the last instant
        found = tracking.Tracking(t, np.zeros((1000, DOF)), swinging, HOME)
        assert found.error_norm[-1] < 1e-9
        assert found.settled == pytest.approx(0.1, rel=0.01)

    def test_each_joint_alone_arrives(self, rig):
        assert max(step.settled for step in tracking.single_joint_steps(rig, 0.1, 0.6)) < 0.001

    def test_a_blocked_joint_does_not_and_its_neighbours_do(self, scene, kinematics):
        spec = build_spec(scene, visuals=False)
        spec.joint("left_panda_joint5").frictionloss = 50.0  # more than its motor can
        blocked = rig_of(World(scene, model=spec.compile()), kinematics)
        errors = np.array([step.settled for step in tracking.single_joint_steps(blocked, 0.1, 0.6)])
        assert errors[4] > 0.05
        assert np.delete(errors, 4).max() < 0.005

    def test_the_swing_is_followed_in_real_time(self, rig):
        sine = tracking.sine_response(rig, 0.3, 0.5, 2.0)
        assert sine.rms < 0.002
        assert (sine.contacts, sine.stopped) == (0, "")
        assert np.ptp(sine.measured, axis=0) == pytest.approx(np.full(DOF, 0.6), abs=0.01)
        assert 0.0 < sine.step_us < 1000.0

    def test_a_swing_may_end_between_two_rests(self, rig):
        assert tracking.sine_response(rig, 0.3, 0.5, 0.7).rms < 0.002

    def test_a_slack_and_slow_controller_fails_the_swing(self, rig, monkeypatch):
        import time

        update = rig.stack.manager.update

        def weak(q, v):
            time.sleep(0.0012)
            return 0.7 * update(q, v)

        motion = tracking.start_swing(rig, 0.3, 0.5, 0.3)
        monkeypatch.setattr(rig.stack.manager, "update", weak)
        sine = tracking.track(rig, motion.q[1:301])
        assert sine.rms > 0.02
        assert sine.step_us > 1000.0
        refused = {name for name, check in judged(sine=sine).items() if check.passed is False}
        assert {"tracking.sine_rms_rad", "control.step_median_us"} <= refused

    def test_the_swings_reference_is_consistent_and_starts_at_rest(self):
        h = 1e-6
        for t in (0.0, 0.3, 1.7):
            _, v, a = tracking.sine_reference(DUAL_PANDA, 0.3, 0.5, t)
            after = tracking.sine_reference(DUAL_PANDA, 0.3, 0.5, t + h)
            before = tracking.sine_reference(DUAL_PANDA, 0.3, 0.5, t - h)
            assert (after[0] - before[0]) / (2 * h) == pytest.approx(v, abs=1e-8)
            assert (after[1] - before[1]) / (2 * h) == pytest.approx(a, abs=1e-8)
        assert not tracking.sine_reference(DUAL_PANDA, 0.3, 0.5, 0.0)[1].any()
        with pytest.raises(ValueError, match="velocity limits"):
            tracking.sine_reference(DUAL_PANDA, 0.5, 1.0, 0.0)
        with pytest.raises(ValueError, match="joint limits"):
            tracking.sine_reference(DUAL_PANDA, 2.0, 0.1, 0.0)


class TestResponses:
    def test_the_rise_of_a_known_curve(self):
        t = np.arange(1000) * 1e-3
        measured = np.tile(HOME, (1000, 1))
        measured[:, 3] += 0.1 * (1.0 - np.exp(-t / 0.05))  # rises in 0.05 ln 9
        target = HOME + 0.1 * np.eye(DOF)[3]
        step = tracking.Tracking(t, np.tile(target, (1000, 1)), measured, HOME)
        assert joint_responses(DUAL_PANDA, [step] * DOF, step)[3]["rise_s"] == pytest.approx(
            0.05 * np.log(9.0),
            abs=1.1e-3,
        )

    def test_overshoot_and_never_arriving_are_seen_on_either_side(self):
        t = np.arange(1000) * 1e-3
        for sign in (1.0, -1.0):
            target = HOME + sign * 0.1 * np.eye(DOF)[5]
            measured = np.tile(HOME, (1000, 1))
            measured[:, 5] += sign * 0.1 * (1.0 - np.exp(-t / 0.05) * np.cos(40.0 * t))
            beyond = sign * (measured[:, 5] - target[5])
            step = tracking.Tracking(t, np.tile(target, (1000, 1)), measured, HOME)
            still = step._replace(measured=np.tile(HOME, (1000, 1)))
            row = joint_responses(DUAL_PANDA, [step] * DOF, step)[5]
            assert row["overshoot_rad"] == pytest.approx(beyond.max(), rel=1e-9)
            assert row["step_rad"] == pytest.approx(sign * 0.1)
            assert np.isnan(joint_responses(DUAL_PANDA, [still] * DOF, step)[5]["rise_s"])

    def test_a_joint_that_never_arrives_fails_the_rise_time(self):
        rows = list(measured().responses)
        rows[6] = rows[6] | {"rise_s": float("nan")}
        rise = judged(responses=rows)["joints.rise_max_s"]
        assert rise.passed is False
        assert "left_panda_joint7" in rise.remedy


class TestLatency:
    def test_a_command_waits_for_the_arbiter_and_for_nothing_else(self, rig):
        found = command_latency(rig, repeats_n=10)
        assert found.ticks == (
            1,
            *range(20, 1, -1),
        )  # the later after a tick, the nearer the next one
        assert found.late_steps == 0
        assert 0.0 < found.wall_us < 5000.0

    def test_a_controller_that_lags_a_step_is_seen(self, rig):
        guard = rig.supervisor.guard
        late = []

        def lagging(t, q, v, tau, *_):
            late.append(tau.copy())
            return guard(t, q, v, late[max(0, len(late) - 3)])

        rig.supervisor.guard = lagging
        found = command_latency(rig, repeats_n=1)
        assert (min(found.ticks), max(found.ticks)) == (3, 22)
        check = judged(latency=found)["latency.late_steps"]
        assert (check.observed, check.passed) == (2, False)

    def test_a_command_that_never_arrives_counts_as_late(self, rig, monkeypatch):
        monkeypatch.setattr(CommandArbiter, "propose", lambda *_: None)
        assert set(command_latency(rig, repeats_n=1).ticks) == {60}

    def test_a_source_that_does_not_get_the_arms_is_told(self, world, kinematics, monkeypatch):
        monkeypatch.setattr(ControlStack, "request", lambda *_: None)
        never = tracking.TrackingRig(world, kinematics, Config())
        step = tracking.step_response(never, HOME, 0.1)
        check = judged(step=step)["control.stopped"]
        assert check.passed is False
        assert "the arms were not given" in check.remedy

    def test_an_emergency_stop_brings_swinging_arms_to_rest(self, rig):
        stop = emergency_stop(rig, 0.3, 0.5)
        assert stop.ticks == 1
        assert stop.speed_rad_s > 0.85
        assert 0.05 < stop.rest_s < 0.5

    def test_another_reflex_is_no_emergency_stop(self, world, kinematics, monkeypatch):
        slow = rig_of(world, kinematics, velocity_scale=0.2)
        assert emergency_stop(slow, 0.3, 0.5).ticks == 0  # stopped before it was pressed
        monkeypatch.setattr(
            Supervisor,
            "estop",
            lambda self, *_: setattr(self, "_deadline_s", -1.0),
        )
        assert (
            emergency_stop(rig_of(world, kinematics), 0.3, 0.5).ticks == 0
        )  # in the tick of the call

    def test_a_supervisor_that_ignores_the_button_is_seen(self, rig, monkeypatch):
        monkeypatch.setattr(Supervisor, "estop", lambda *_: None)
        stop = emergency_stop(rig, 0.3, 0.5)
        assert np.isnan(stop.rest_s)
        assert {name for name, check in judged(stop=stop).items() if check.passed is False} == {
            "stop.ticks",
            "stop.rest_s",
        }


class TestContacts:
    def test_none_at_home_though_the_rod_touches_the_table(self, world):
        assert world.data.ncon > 0
        assert arm_contacts(world) == []

    def test_a_hand_in_the_table_is_counted_and_named(self, world):
        q = HOME.copy()
        q[1], q[3] = 1.0, -1.6
        world.reset(q)
        pairs = arm_contacts(world)
        assert pairs
        assert any("table" in pair[:2] for pair in pairs)

    def test_arms_that_reach_across_collide(self, world):
        q = HOME.copy()
        q[0], q[7] = -0.9, 0.9
        world.reset(q)
        assert any(
            a.startswith("left_") and b.startswith("right_") for a, b, _ in arm_contacts(world)
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
            World(scene, model=spec.compile()),
            kinematics,
            np.random.default_rng(0),
            2,
        )
        assert found["inertia_kg_m2"] == pytest.approx(0.01)
        assert max(found["position_m"], found["bias_nm"]) < 1e-11

    def test_a_moved_base_shows_in_the_position(self, scene, kinematics):
        spec = build_spec(scene, visuals=False)
        spec.body("right_panda_link0").pos += [0.001, 0.0, 0.0]
        found = measure.model_agreement(
            World(scene, model=spec.compile()),
            kinematics,
            np.random.default_rng(0),
            2,
        )
        assert found["position_m"] == pytest.approx(0.001)

    def test_a_changed_mass_shows_in_gravity(self, world):
        other = Kinematics()
        other.model = other.model.copy()
        other.model.inertias[5].mass += 0.1
        other.data = other.model.createData()
        assert measure.model_agreement(world, other, np.random.default_rng(0), 2)["bias_nm"] > 1e-3


class TestLibraries:
    def test_everything_required_is_found(self):
        libraries = {library.name: library for library in required_libraries()}
        assert {"mujoco", "pin", "ompl", "torch", "lerobot"} <= set(libraries)
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
            library.name: (library.wanted, library.found, library.fits)
            for library in required_libraries()
        }
        assert read == {
            "a": ("<2,>=1", "1.5", True),
            "b": ("~=3.0", "2.0", False),
            "D": ("", None, False),
        }


class TestBill:
    def test_it_names_versions_and_no_private_path(self, tmp_path, capsys, monkeypatch):
        monkeypatch.setenv("HOME", "/home/somebody")
        assert (
            run_command_line(["env-check", "--markdown", "--runs-dir", str(tmp_path)], STAGES) == 0
        )
        out = capsys.readouterr().out
        assert out.startswith("### minidual environment\n")
        for word in (
            "| python | 3.12",
            "| gl renderer | ",
            "| mujoco | ",
            "| processor | ",
            "env-check has not run",
        ):
            assert word in out
        for private in (
            str(tmp_path),
            str(Path.home()),
            str(Path(minidual.__file__).parent),
            f" {platform.node()} ",
        ):
            assert private not in out
        assert list(tmp_path.iterdir()) == []

    def test_json_is_the_same_as_a_document(self, tmp_path, capsys):
        assert (
            run_command_line(
                ["env-check", "--markdown", "--json", "--runs-dir", str(tmp_path)],
                STAGES,
            )
            == 0
        )
        document = json.loads(capsys.readouterr().out)
        assert "mujoco" in {row["name"] for row in document["libraries"]}
        assert document["about"]["minidual"] == minidual.__version__

    def test_it_comes_out_without_opengl_too(self, tmp_path, capsys, monkeypatch):
        def broken(*_args):
            raise RuntimeError("no EGL")

        monkeypatch.setattr("minidual.plant.render.mujoco.Renderer", broken)
        assert (
            run_command_line(["env-check", "--markdown", "--runs-dir", str(tmp_path)], STAGES) == 0
        )
        assert "| gl renderer | none: cannot create" in capsys.readouterr().out

    def test_it_marks_what_is_unfit_and_what_failed(self, tmp_path, capsys, monkeypatch):
        monkeypatch.setattr(
            installation,
            "required_libraries",
            lambda: [Library("mujoco", ">=4", "3.9")],
        )
        verdict = SimpleNamespace(
            status="fail",
            finished_at="now",
            fingerprint=SimpleNamespace(profile="standard"),
        )
        verdict.failed_checks = all_failing_checks
        monkeypatch.setattr(installation, "read_verdict", lambda _path: (verdict, ""))
        assert (
            run_command_line(["env-check", "--markdown", "--runs-dir", str(tmp_path)], STAGES) == 0
        )
        lines = capsys.readouterr().out.splitlines()
        assert "| mujoco | >=4 | 3.9 | **unfit** |" in lines
        assert "env-check: **fail** on now, profile standard" in lines
        assert "- joints.count is 13, limit == 14" in lines


def test_the_scene_is_part_of_what_makes_the_verdict_stale():
    one = Config()
    other = Config(scene=SceneConfig(physics=PhysicsConfig(impratio=50.0)))
    assert STAGES["env-check"].parameters(one) != STAGES["env-check"].parameters(other)
