"""A count or limit that asks for less than the shipped profile is no acceptance.

Nor are the stages downstream.
"""

from __future__ import annotations

import pytest

from minidual.cli.app import run_command_line
from minidual.config.base import limits
from minidual.config.loader import load_config
from minidual.errors import ConfigError
from minidual.gate.table import StageEntry, StageTable
from minidual.gate.verdict import verdict_from_json
from minidual.stages.registry import STAGES
from tests.support.pipeline_toys import KNOB, Bench

PROFILES = ("standard", "gpu")
FURTHER = ",".join(load_config("standard").config.benchmark.further_tasks)


@pytest.mark.parametrize("profile", PROFILES)
def test_a_shipped_profile_asks_for_itself(profile):
    loaded = load_config(profile)
    assert [entry.weaker(loaded.config, loaded.reference()) for entry in STAGES.values()] == [
        (),
    ] * len(STAGES)


@pytest.mark.parametrize(
    ("stage", "override", "line"),
    [
        ("deploy", "deploy.trials=1", "deploy.trials is 1, the profile asks for 100"),
        (
            "teleop-record",
            "teleop.episodes_n=3",
            "teleop.episodes_n is 3, the profile asks for 150",
        ),
        (
            "carry",
            "carry.limits.tilt_max_rad=0.05",
            "carry.limits.tilt_max_rad is 0.05, the profile asks for 0.0349",
        ),
        ("carry", "scene.task.goal_tolerance_m=0.025", "scene.task.goal_tolerance_m is 0.025"),
        (
            "plan",
            "plan.time_median_max_s.left_arm=0.3",
            "plan.time_median_max_s.left_arm is 0.3, the profile asks for 0.2",
        ),
        (
            "plan",
            "plan.time_median_max_s.both_arms=null",
            "plan.time_median_max_s.both_arms is None, the profile asks for 2.0",
        ),
        ("benchmark", "benchmark.success_rate_min.act=0.1", "'act': 0.1"),
        ("benchmark", "benchmark.methods=[moveit]", "benchmark.methods is moveit"),
        (
            "benchmark",
            "benchmark.conditions=[clean]",
            "benchmark.conditions is clean, the profile asks for clean, randomised",
        ),
        ("benchmark", "benchmark.trials_n=1", "benchmark.trials_n is 1, the profile asks for 30"),
        (
            "benchmark",
            "benchmark.success_rate_min={}",
            "benchmark.success_rate_min is {}, the profile asks for {'moveit'",
        ),
        (
            "benchmark",
            "benchmark.tasks=[rod_carry]",
            (
                "benchmark.tasks is {'rod_carry': 30}, "
                "the profile asks for {'pot_lift': 6, 'handover': 6, 'insertion': 6"
            ),
        ),
        ("benchmark", f"benchmark.tasks=[{FURTHER}]", "benchmark.own_task is False"),
        (
            "benchmark",
            "benchmark.further_tasks={}",
            "benchmark.tasks is {}, the profile asks for {'pot_lift': 6",
        ),
        ("benchmark", "benchmark.further_tasks.insertion=5", "'insertion': 5"),
        (
            "benchmark",
            "benchmark.condition_trials.randomised.insertion=49",
            "benchmark.condition_trials is {'randomised': {'rod_carry': 60",
        ),
        (
            "benchmark",
            "benchmark.condition_trials={}",
            "benchmark.condition_trials is {}, the profile asks for {'randomised'",
        ),
        (
            "deploy",
            "deploy.success_rate_min=null",
            "deploy.success_rate_min is None, the profile asks for 0.949",
        ),
        ("env-check", "env_check.sine_amplitude_rad=0.01", "env_check.sine_amplitude_rad is 0.01"),
        (
            "env-check",
            "env_check.step_rad=0.05",
            "env_check.step_rad is 0.05, the profile asks for 0.3",
        ),
        (
            "env-check",
            "env_check.step_duration_s=10",
            "env_check.step_duration_s is 10.0, the profile asks for 2.0",
        ),
        ("plan", "plan.blocked_fraction=0", "plan.blocked_fraction is 0.0"),
        (
            "carry",
            "carry.sensing.pose_noise_m=0",
            "carry.sensing.pose_noise_m is 0.0, the profile asks for 0.0005",
        ),
        (
            "carry",
            "carry.sensing.delay_s=0",
            "carry.sensing.delay_s is 0.0, the profile asks for 0.01",
        ),
        (
            "carry",
            "scene.task.goal_xy_m=[0.5, 0.2]",
            "scene.task.distance_m is 0.05, the profile asks for 0.5",
        ),
    ],
)
def test_less_is_said(stage, override, line):
    loaded = load_config("standard", [override])
    (found,) = STAGES[stage].weaker(loaded.config, loaded.reference())
    assert line in found


@pytest.mark.parametrize(
    "override",
    [
        "deploy.trials=200",
        "benchmark.conditions=[all]",
        "carry.limits.tilt_max_rad=0.01",
        f"benchmark.tasks=[{FURTHER},rod_carry]",
        "benchmark.further_tasks.insertion=21",
        "benchmark.condition_trials.randomised.insertion=51",
        "task=handover",
    ],
)
def test_more_is_no_less(override):
    loaded = load_config("standard", [override])
    assert not any(entry.weaker(loaded.config, loaded.reference()) for entry in STAGES.values())


def test_a_profile_of_ones_own_is_held_to_the_one_it_extends(tmp_path):
    mine = tmp_path / "mine.yaml"
    mine.write_text("extends: gpu\ncarry: {trials_n: 5}\n", encoding="utf-8")
    loaded = load_config(str(mine))
    assert STAGES["carry"].weaker(loaded.config, loaded.reference()) == (
        "carry.trials_n is 5, the profile asks for 200",
    )
    assert (
        STAGES["train-act"].weaker(loaded.config, loaded.reference()) == ()
    )  # its day of training is the profile's


def test_every_limit_is_read_by_a_stage():
    for path, _, _ in limits(load_config().config):
        assert any(
            path == read or path.startswith(f"{read}.")
            for entry in STAGES.values()
            for read in entry.reads
        ), path


@pytest.mark.parametrize(
    "path",
    ["carry.limits.success_rate_min", "plan.success_rate_min", "deploy.success_rate_min"],
)
@pytest.mark.parametrize("value", ["-1", "1.1"])
def test_a_rate_out_of_0_to_1_is_refused(path, value):
    with pytest.raises(ConfigError, match=path):
        load_config("standard", [f"{path}={value}"])


def test_a_rate_of_a_method_out_of_0_to_1_is_refused():
    with pytest.raises(ConfigError, match=r"benchmark\.success_rate_min\.act"):
        load_config("standard", ["benchmark.success_rate_min.act=-1"])


@pytest.mark.parametrize(
    "path",
    ["carry.trials_n", "deploy.trials", "benchmark.trials_n", "teleop.episodes_n"],
)
def test_no_trials_are_refused(path):
    with pytest.raises(ConfigError, match=path):
        load_config("standard", [f"{path}=0"])


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path)
    entries = [
        StageEntry("first", bench.first, (), "One", (KNOB,)),
        StageEntry("second", bench.second, ("first",), "Two"),
    ]
    bench.table = StageTable(entries, libraries=("numpy",))
    return bench


def test_it_passes_and_does_not_count_nor_what_rests_on_it(bench, capsys):
    for outcome in bench.runner(f"{KNOB}=3").run_until():
        verdict = outcome.verdict
        assert (verdict.status, verdict.acceptance) == ("pass", False)
        assert verdict.weakened == (f"first: {KNOB} is 3, the profile asks for 100",)
        assert verdict_from_json(verdict.to_json()).weakened == verdict.weakened
    words = ["status", "--run", "toys", "--runs-dir", str(bench.root), "--set", f"{KNOB}=3"]
    assert run_command_line(words, bench.table) == 0
    assert (
        "NO ACCEPTANCE, it asks for less than the profile: first: plan.queries_n is 3"
        in " ".join(capsys.readouterr().out.split())
    )


def test_what_asks_for_as_much_counts(bench):
    assert [outcome.verdict.acceptance for outcome in bench.runner().run_until()] == [True, True]
