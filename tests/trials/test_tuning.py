"""The search for gains: on carries whose law is known, so that the right answer is known too."""

import numpy as np
import pytest

from minidual.config.loader import load_config
from minidual.config.root import Config, changed
from minidual.gate.stage import ToolContext
from minidual.stages.carry_tools import tune
from minidual.tasks.catalogue import task_config
from minidual.trials import tuning
from minidual.trials.metrics import TrialMetrics
from minidual.trials.tuning import (
    FORCE_FACTOR,
    FORCES_N,
    OSCILLATION_MAX_M,
    STIFFNESSES_N_PER_M,
    Tuner,
    TuningError,
    gains,
    oscillation_m,
)

NEEDED_N = Config().scene.task.internal_force_min_n


@pytest.fixture
def plant(monkeypatch):
    """A plant that loses 2 N of squeeze, slips over 60 N and oscillates from a set stiffness."""
    law = {
        "loss_n": 2.0,
        "slips_n": 60.0,
        "oscillates": 1e9,
        "torque": 0.7,
        "failure": "squeezed",
        "tracking_m": 0.001,
    }
    starts = []

    def carry_once(inputs, trial):
        impedance = inputs.config.carry.impedance
        starts.append((trial.purpose, *trial.start.values()))
        least = impedance.internal_force_n - law["loss_n"]
        holds = least > NEEDED_N and impedance.internal_force_n < law["slips_n"]
        oscillation = OSCILLATION_MAX_M * impedance.stiffness_n_per_m / law["oscillates"]
        return TrialMetrics(
            method="impedance",
            index=trial.index,
            condition="clean",
            success=holds,
            failure="" if holds else law["failure"],
            reason="" if holds else "too weak",
            failed_at_s=float("nan") if holds else 1.0,
            duration_s=6.0 if holds else float("nan"),
            torque_ratio_max=law["torque"],
            jerk_rms=20.0,
            tilt_max_rad=0.001,
            path_length_m=1.4,
            internal_force_min_n=least,
            pinch_force_min_n=60.0,
            goal_error_m=0.001,
            measured={"tracking_max_m": law["tracking_m"], "oscillation_m": oscillation},
        )

    monkeypatch.setattr(tuning, "carry_once", carry_once)
    law["starts"] = starts
    return law


def test_the_least_force_that_holds_is_found_and_scaled(plant):
    found = Tuner(Config(), 3).run()
    assert NEEDED_N + 2.0 < found.least_force_n < NEEDED_N + 3.0
    assert found.force_n == pytest.approx(FORCE_FACTOR * found.least_force_n, abs=0.05)
    assert next(s for s in found.steps if s.phase == "final").holds
    assert found.stiffness_n_per_m == STIFFNESSES_N_PER_M[-1]


def test_the_stiffness_stays_clear_of_oscillation(plant):
    plant["oscillates"] = 400.0
    found = Tuner(Config(), 3).run()
    assert 0.8 * 370.0 - 0.5 < found.stiffness_n_per_m <= 0.8 * 400.0 + 0.5


def test_forces_that_do_not_hold_are_shown_as_such(plant):
    found = Tuner(Config(), 3).run()
    compared = [s for s in found.steps if s.phase == "compared"]
    assert [s.holds for s in compared] == [False, True, False]  # 20 N is too little, 80 N slips
    assert compared[0].row()["successes"] == "0 of 5"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"loss_n": 30.0}, "no squeeze up to 40 N holds"),
        ({"torque": 0.99}, "already takes 99 %"),
        ({"torque": float("nan")}, "already takes nan %"),
        ({"failure": "held"}, "is not safe: trial 0, too weak, at 1.00 s"),
        ({"tracking_m": 0.011}, "tracking 11.0 mm"),
        ({"oscillates": 100.0}, "oscillates even at 150"),
    ],
)
def test_a_plant_that_cannot_be_tuned_says_why(plant, change, message):
    plant.update(change)
    with pytest.raises(TuningError, match=message):
        Tuner(Config(), 3).run()


def test_tuning_sees_starts_of_its_own_stream(plant):
    Tuner(Config(), 3).run()
    assert {purpose for purpose, _ in plant["starts"]} == {"tuning"}
    assert len({start for _, start in plant["starts"]}) == tuning.CARRIES_N


def tool_context(config, folder, shipped="standard"):
    return ToolContext(
        config=config,
        seed=3,
        profile="mine",
        run_folder=folder,
        name="carry-tune",
        shipped=shipped,
    )


def test_the_profile_that_is_written_loads(plant, tmp_path):
    context = tool_context(Config(), tmp_path)
    result = tune(context)
    context.publish()
    loaded = load_config(str(tmp_path / "carry-tune" / "tuned.yaml")).config.carry.impedance
    assert loaded.internal_force_n == pytest.approx(
        result.data["settings"]["carry.impedance.internal_force_n"],
        abs=0.01,
    )
    assert (tmp_path / "carry-tune" / "tuning.svg").stat().st_size > 10_000
    assert (tmp_path / "carry-tune" / "tuning.csv").read_text().startswith("phase,")


def test_the_profile_holds_for_what_was_tuned(plant, tmp_path):
    """Gains of a glass, or of a softer pinch, must not end in a profile of something else."""
    config = load_config(
        "standard",
        ["carry.object=glass", "carry.impedance.pinch_n=33", "scene.object.friction=0.45"],
    ).config
    context = tool_context(config, tmp_path)
    tune(context)
    context.publish()
    loaded = load_config(str(tmp_path / "carry-tune" / "tuned.yaml")).config
    assert loaded.carry.object == "glass"
    assert loaded.carry.impedance.pinch_n == 33.0
    assert loaded.scene.object.friction == 0.45


@pytest.mark.parametrize("extends", ["extends: standard\n", "extends: smoke\n", ""])
def test_the_profile_keeps_all_that_ones_own_profile_says(plant, tmp_path, extends):
    """Arm and arbiter too: gains hold only for those with which they were tuned."""
    mine = tmp_path / "mine.yaml"
    mine.write_text(
        f"{extends}seed: 7\nworkers: 1\nview: {{port: 9000}}\nrobot: {{arm: xarm7}}\n"
        "arbiter: {speed_override: 0.5}\n"
        "deploy: {trials: 3}\nscene: {object: {friction: 0.5}}\n",
    )
    loaded = load_config(str(mine), ["carry.object=glass"])
    context = tool_context(loaded.config, tmp_path / "my runs", loaded.shipped)
    result = tune(context)
    context.publish()
    written = tmp_path / "my runs" / "carry-tune" / "tuned.yaml"
    assert f"use it: minidual run --until carry --profile '{written}'" in result.notes
    tuned = load_config(str(written))
    given = loaded.config
    of_the_run = {name: getattr(tuned.config, name) for name in ("seed", "workers", "view")}
    motion = {"carry.motion": task_config(given).carry.motion}
    assert tuned.config == changed(given, {**of_the_run, **motion, **result.data["settings"]})
    assert tuned.reference() == loaded.reference()
    assert of_the_run == {
        name: getattr(load_config(loaded.shipped or "standard").config, name) for name in of_the_run
    }
    # The friction is the default, and was set: a glass does not bring its own.
    assert (
        task_config(tuned.config).scene.object.friction
        == task_config(given).scene.object.friction
        == 0.5
    )


def test_what_was_tried_stays_when_nothing_was_found(plant, tmp_path):
    plant["loss_n"] = 30.0
    with pytest.raises(TuningError):
        tune(tool_context(Config(), tmp_path))
    assert "force" in (tmp_path / "carry-tune" / "tuning.csv").read_text()


def test_oscillation_is_what_is_fast_alone():
    t = np.arange(0.0, 2.0, 1.0 / 250.0)
    slow = np.zeros((len(t), 3))
    fast = np.zeros((len(t), 3))
    slow[:, 0] = 0.01 * np.sin(2 * np.pi * 0.5 * t)
    fast[:, 0] = 0.001 * np.sin(2 * np.pi * 20.0 * t)
    assert oscillation_m(slow) < 5e-5
    assert oscillation_m(slow + fast) == pytest.approx(0.001 / np.sqrt(2.0), rel=0.05)
    assert np.isnan(oscillation_m(fast[:50]))


def test_gains_stay_inside_the_configuration():
    assert gains(40.0, 500.0)["stiffness_nm_per_rad"] == pytest.approx(80.0)
    ceiling = changed(Config(), {"carry.impedance.internal_force_n": FORCE_FACTOR * FORCES_N[-1]})
    assert ceiling.carry.impedance.internal_force_n < 80.0, (
        "the factor may not lead past the safety ceiling"
    )
    for n in (*FORCES_N, *tuning.COMPARED_N):
        changed(Config(), {"carry.impedance.internal_force_n": n})
    with pytest.raises(ValueError, match="less than or equal to 80"):
        changed(Config(), {"carry.impedance.internal_force_n": 80.1})
