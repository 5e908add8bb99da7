"""`env-check` as a stage: it passes on the real scene, and its artefacts and data are whole."""

import csv
import json

import av
import numpy as np
import pytest

from minidual.config.control import EnvCheckConfig
from minidual.config.root import Config
from minidual.config.scene import PhysicsConfig, SceneConfig
from minidual.errors import EnvironmentMissingError
from minidual.gate.stage import StageContext
from minidual.plant.model import build_spec
from minidual.show.figures.film import FILM_FPS
from minidual.stages.env_check.checks import measured_checks
from minidual.stages.env_check.stage import run
from minidual.stages.registry import STAGES
from tests.support.env_check_samples import JOINT_NAMES, QUICK, all_failing_checks
from tests.support.read_recorder import recorded, unlisted


def run_stage(folder, **changes):
    return run_with(folder, Config(env_check=QUICK.model_copy(update=changes)))


def run_with(folder, config):
    context = StageContext(folder=folder, config=config, seed=config.seed, profile="standard")
    return run(context)


def failed(result):
    return {check.name for check in result.checks if check.passed is False}


@pytest.fixture(scope="module")
def passed(tmp_path_factory):
    """Return the stage's folder, its result, what measured_checks was given and values read."""
    folder = tmp_path_factory.mktemp("env-check")
    given = []

    def judged(*arguments):
        given.extend(arguments)
        return measured_checks(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("minidual.stages.env_check.stage.measured_checks", judged)
        config, reads = recorded(Config(env_check=QUICK))
        return folder, run_with(folder, config), given, reads


class TestStage:
    def test_it_reads_no_value_that_its_verdict_does_not_record(self, passed):
        reads = passed[3]
        assert unlisted(reads, [*STAGES["env-check"].reads, "seed"]) == []
        assert "scene.task.goal_xy_m" in reads

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
        folder, result, *_ = passed
        assert {p.name for p in folder.iterdir()} == {
            "sine.mp4",
            "cameras.png",
            "tracking.svg",
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
        checks = measured_checks(found, QUICK.model_copy(update=tight), *others)
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


def test_the_scene_is_part_of_what_makes_the_verdict_stale():
    one = Config()
    other = Config(scene=SceneConfig(physics=PhysicsConfig(impratio=50.0)))
    assert STAGES["env-check"].parameters(one) != STAGES["env-check"].parameters(other)
